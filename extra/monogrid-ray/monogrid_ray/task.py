"""One recording, on the computer that a worker runs on: fetched, done by `monogrid batch --task`, sent."""

import hashlib
import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from .places import Store, fetch_source, is_url, stamp
from .scratch import held, own_folder, private_folder, write_own

#: What the source was when the recording was done, beside its task.json.
STAMP_FILE = "source-stamp.txt"
#: Classes that say something about the recording: the same run would end so again. All others are done again.
FINAL = ("ok", "lost", "not-started", "bad-input", "timeout")


@dataclass(frozen=True)
class Task:
    """A recording as the driver planned it."""

    #: Name of its results.
    name: str
    #: A path, or an address in an object store.
    source: str
    #: Where the program finds it: the path, or where an object is fetched to (`own_place`).
    local_source: str
    #: Line of a list, without its source and name: options separated by tabs.
    options: str
    #: What `monogrid batch --dry-run --json` says of it.
    plan: dict


@dataclass(frozen=True)
class Job:
    """What all tasks share."""

    #: A folder that all computers see, or an address in an object store.
    out: str
    #: Folder for what is fetched and not yet sent, on every computer.
    scratch: str
    #: The program, by name or path.
    program: str
    #: Arguments of `monogrid batch` for all.
    arguments: tuple[str, ...]
    #: The folder in which paths of options are meant.
    folder: str
    #: Threads of a run: those of the processors that Ray gives it.
    threads: int


class NotRun(Exception):
    """The program itself could not work: its message."""


def own_place(name: str, local: str, scratch: str) -> str:
    """Where a source is fetched to for one task alone: a folder of the task's name, which no other has."""
    return os.path.join(os.path.abspath(scratch), "sources", name, os.path.basename(local))


def finished(task: Task, out: Store, retry: tuple[str, ...]) -> dict | None:
    """The record of a recording in an object store that is done: of the same work, with nothing changed since."""
    text = out.read(f"tasks/{task.name}/task.json")
    if text is None:
        return None
    record = json.loads(text)
    is_same = (
        record["source"] == task.local_source
        and record["options"] == task.plan["options"]
        and record["settings_sha256"] == task.plan["settings_sha256"]
        and record["version"] == task.plan["version"]
    )
    if not is_same or record["class"] not in FINAL or record["class"] in retry:
        return None
    before, now = out.read(f"tasks/{task.name}/{STAMP_FILE}"), stamp(task.source)
    # what came of a recording stays when the recording is gone
    if before is None or now is not None and before.decode() != now:
        return None
    there = {file["name"]: file["bytes"] for file in out.files(f"runs/{task.name}")}
    is_whole = all(there.get(name) == output["bytes"] for name, output in record["outputs"].items())
    return record if is_whole else None


def carry_out(task: Task, job: Job) -> dict:
    """Does a recording; its record. Whatever ends halfway leaves a folder with which the next try goes on."""
    scratch = private_folder(Path(job.scratch))
    for name in ("lists", "pids", "sources", "out", "sent"):
        own_folder(scratch / name)
    # tasks of one name, of two batches or of a worker that was taken for lost, are done one after the other
    with held(scratch / "pids" / task.name):
        return carry_out_alone(task, job, scratch)


def carry_out_alone(task: Task, job: Job, scratch: Path) -> dict:
    """Does a recording whose name nobody else on this computer works on."""
    before, local = stamp(task.source), task.local_source
    if is_url(task.source):
        local = own_place(task.name, local, job.scratch)
        folder = Path(local).parent
        own_folder(folder)
        # of a worker that was lost; what is fetched is all that lies there
        remove(Path(local))
        if before is not None:
            fetch_source(task.source, Path(local))
    out = scratch / "out" if is_url(job.out) else Path(job.out)
    if is_url(job.out):
        remove_files(task, Store(job.out))
    call_program(task, job, local, out)
    record = json.loads((out / "tasks" / task.name / "task.json").read_text())
    if is_url(job.out):
        send(task, out, Store(job.out), str(before), record)
        for kind in ("runs", "tasks"):
            remove_at_once(out / kind / task.name, scratch / "sent" / kind / task.name)
    if is_url(task.source):
        remove(folder)
    return record


def remove_files(task: Task, store: Store) -> None:
    """Removes what an earlier run wrote beside its folder (`mcap=FILE`) and is as it was: only its record in the store knows of it."""
    text = store.read(f"tasks/{task.name}/task.json")
    for path, output in (json.loads(text).get("files", {}) if text else {}).items():
        if os.path.isfile(path) and not os.path.islink(path):
            digest = hashlib.sha256()
            with open(path, "rb") as file:
                while chunk := file.read(1 << 20):
                    digest.update(chunk)
            is_same = digest.hexdigest() == output["sha256"]
            if is_same:
                os.unlink(path)


def call_program(task: Task, job: Job, local: str, out: Path) -> None:
    """Calls `monogrid batch` for one recording, and ends it with this process."""
    listed = Path(job.scratch) / "lists" / f"{task.name}.tsv"
    write_own(listed, f"{local}\tname={task.name}\t{task.options}\n")
    command = [job.program, "batch", str(listed), "--out", str(out), "--task", task.name, "--jobs", "1"]
    command += ["--threads", str(job.threads), *job.arguments]
    environment = dict(os.environ, MONOGRID_PARENT=str(os.getpid()))
    folder = job.folder if os.path.isdir(job.folder) else None
    ended = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    # 0, 1, 3 and 4 are said of the recording, in its record
    if ended.returncode not in (0, 1, 3, 4) or not (out / "tasks" / task.name / "task.json").is_file():
        said = ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"]
        raise NotRun(f"{task.name}: {said[-1]}")


def send(task: Task, out: Path, store: Store, before: str, record: dict) -> None:
    """Sends all results; the record is the last, so that a recording without one is not done."""
    runs, tasks = f"runs/{task.name}", f"tasks/{task.name}"
    for old in store.files(runs):
        if old["name"] not in record["outputs"]:
            store.remove(f"{runs}/{old['name']}")
    for name in record["outputs"]:
        store.send(out / runs / name, f"{runs}/{name}")
    store.send(out / tasks / "log.txt", f"{tasks}/log.txt")
    store.write(before.encode(), f"{tasks}/{STAMP_FILE}")
    store.send(out / tasks / "task.json", f"{tasks}/task.json")


def remove_at_once(folder: Path, aside: Path) -> None:
    """Removes a folder that other tasks may be looking through: they find it whole or not at all. A run that never began has none."""
    if not folder.is_dir():
        return
    aside.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(aside, ignore_errors=True)
    folder.rename(aside)
    shutil.rmtree(aside, ignore_errors=True)


def remove(path: Path) -> None:
    """Removes what was fetched."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
