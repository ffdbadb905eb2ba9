"""Which recordings are to be done, and where: placement by memory, retries when workers or computers are lost, progress."""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import ray

from .places import Store, is_url
from .scratch import Unsafe, private_folder
from .task import Job, Task, carry_out, finished, own_place
from .terminal import printable

#: Memory that a run is expected to take while nothing is known, bytes.
FIRST_GUESS = 1_000_000_000
#: What the largest run until now is multiplied by.
MARGIN = 1.1
#: Tasks that Ray knows of at once, for each of its processors.
AHEAD = 2


@dataclass
class Batch:
    """A batch as it was asked for."""

    #: Lines of lists, as `monogrid batch` has them; sources may be addresses in object stores.
    lines: list[str]
    #: A folder that all computers see, or an address in an object store.
    out: str
    #: The program, by name or path, on all computers.
    program: str = "monogrid"
    #: Options of `monogrid run` for all recordings: KEY=VALUE.
    each: list[str] = field(default_factory=list)
    #: Stop a run that takes longer, seconds.
    timeout: float | None = None
    #: Classes that are done again although nothing has changed.
    retry: list[str] = field(default_factory=list)
    #: Processors of a task.
    cpus: float = 1
    #: How often a task is begun again when its worker or computer is lost.
    retries: int = 20
    #: Folder for what is fetched and not yet sent, the same on every computer.
    scratch: str = os.path.join(tempfile.gettempdir(), f"monogrid-ray-{os.getuid() if hasattr(os, 'getuid') else 0}")


def plan(batch: Batch) -> list[Task]:
    """The tasks of all lines: the program checks options and makes names. SystemExit with its message where it refuses."""
    filled = [line for line in batch.lines if line.strip() and not line.startswith("#")]
    sources, lines = {}, []
    for line in filled:
        source, _, options = line.rstrip("\r\n").partition("\t")
        local = local_place(source, batch.scratch)
        sources[local] = source
        lines.append(f"{local}\t{options}" if options else local)
    each = [argument for key in batch.each for argument in ("--each", key)]
    with tempfile.TemporaryDirectory() as folder:
        listed, out = Path(folder, "list.tsv"), Path(folder, "out")
        listed.write_text("\n".join(lines) + "\n")
        out = str(out) if is_url(batch.out) else batch.out
        command = [batch.program, "batch", str(listed), "--out", out, "--dry-run", "--json", *each]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode != 0:
        raise SystemExit(printable(ended.stderr.strip() or f"{batch.program} ended with {ended.returncode}"))
    return [task_of(planned, sources, batch.scratch) for planned in json.loads(ended.stdout)]


def local_place(source: str, scratch: str) -> str:
    """What stands for a source in the list that the program checks: it makes names of it."""
    if not is_url(source):
        return os.path.abspath(source)
    scheme, _, rest = source.partition("://")
    parts = [part for part in rest.split("/") if part not in ("", ".", "..")]
    # addresses that differ only in what no path has are two sources
    key = hashlib.sha256(source.encode()).hexdigest()[:16]
    return os.path.join(os.path.abspath(scratch), "sources", scheme, key, *parts)


def task_of(planned: dict, sources: dict[str, str], scratch: str) -> Task:
    """The task that the program planned."""
    options = [option.removeprefix("--") for option in planned["options"]]
    name, listed = planned["name"], planned["source"]
    source = sources[listed]
    local = own_place(name, listed, scratch) if is_url(source) else listed
    return Task(name, source, local, "\t".join(options), planned)


def job_of(batch: Batch) -> Job:
    """What all tasks share."""
    arguments = []
    if batch.timeout is not None:
        arguments += ["--timeout", str(batch.timeout)]
    if batch.retry:
        arguments += ["--retry", ",".join(batch.retry)]
    out = batch.out if is_url(batch.out) else os.path.abspath(batch.out)
    return Job(out, os.path.abspath(batch.scratch), batch.program, tuple(arguments), os.getcwd(), max(1, int(batch.cpus)))


def run(batch: Batch, say=lambda text: print(printable(text), file=sys.stderr, flush=True)) -> dict[str, dict]:
    """Does what is not done, on the cluster that Ray is connected to; the records by name, without those that were given up."""
    job, tasks = job_of(batch), plan(batch)
    try:
        private_folder(Path(job.scratch))
    except Unsafe as error:
        raise SystemExit(f"the scratch folder is not used: {error}") from error
    records, waiting = {}, []
    for task in tasks:
        record = finished(task, Store(job.out), tuple(batch.retry)) if is_url(job.out) else None
        if record is None:
            waiting.append(task)
        else:
            records[task.name] = record
    if records:
        say(f"{len(records)} of {len(tasks)} recordings are done already")
    records.update(carry_out_all(waiting, job, batch, say))
    return records


def carry_out_all(tasks: list[Task], job: Job, batch: Batch, say) -> dict[str, dict]:
    """Gives Ray some tasks at a time, each with the memory that it will take by what is known then."""
    remote = ray.remote(carry_out)
    fixed = {"num_cpus": batch.cpus, "max_retries": batch.retries, "retry_exceptions": [OSError], "scheduling_strategy": "SPREAD"}
    ahead = max(1, int(AHEAD * ray.cluster_resources().get("CPU", 1) / batch.cpus))
    most = max((node["Resources"].get("memory", 0) for node in ray.nodes()), default=0)
    known = [task.plan["peak_rss_bytes"] for task in tasks if task.plan["peak_rss_bytes"]]
    largest = max(known, default=None)
    waiting, running, records = list(reversed(tasks)), {}, {}
    count = 0
    while waiting or running:
        while waiting and len(running) < ahead:
            task = waiting.pop()
            expected = task.plan["peak_rss_bytes"] or (largest * MARGIN if largest else FIRST_GUESS)
            # one that never fits runs where there is most
            memory = int(min(expected, most)) if most else None
            running[remote.options(memory=memory, **fixed).remote(task, job)] = task
        done, _ = ray.wait(list(running), num_returns=1)
        task = running.pop(done[0])
        count += 1
        try:
            record = ray.get(done[0])
        except ray.exceptions.RayError as error:
            reason = str(error).strip().splitlines()[-1]
            say(f"{count}/{len(tasks)} {task.name}: given up: {reason}")
            continue
        records[task.name] = record
        largest = max(filter(None, [largest, record["peak_rss_bytes"]]), default=None)
        say(f"{count}/{len(tasks)} {task.name}: {line(record)}")
    return records


def line(record: dict) -> str:
    """What is said of a recording when it is done."""
    text = record["class"]
    if record["class"] != "ok":
        text += f": {record['reason']}"
    metrics = record["metrics"]
    if metrics:
        share = 100 * metrics["tracked"] // max(metrics["frames"], 1)
        text += f", {share} % of {metrics['frames']} frames"
    return text
