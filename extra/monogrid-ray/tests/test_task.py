"""A recording on one computer: sources of tasks are apart, and the scratch folder is nobody else's. The program is a stand-in that looks
at its source for a while and says what it saw."""

import hashlib
import json
import multiprocessing
import os
import sys
import time
import types
from pathlib import Path

import pytest

pytest.importorskip("obstore")
PACKAGE = Path(__file__).parents[1] / "monogrid_ray"
if "monogrid_ray" not in sys.modules:
    # without the driver, which wants Ray
    package = types.ModuleType("monogrid_ray")
    package.__path__ = [str(PACKAGE)]
    sys.modules["monogrid_ray"] = package

from monogrid_ray import scratch as scratch_folder  # noqa: E402
from monogrid_ray.places import Store  # noqa: E402
from monogrid_ray.scratch import Unsafe  # noqa: E402
from monogrid_ray.task import Job, Task, carry_out, finished  # noqa: E402
from monogrid_ray.terminal import printable  # noqa: E402

PROGRAM = """#!{python}
import json, pathlib, sys, time
listed, out = sys.argv[2], pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
source, name, *options = pathlib.Path(listed).read_text().rstrip("\\n").split("\\t")
seen = []
for _ in range(int(options[0])):
    path = pathlib.Path(source)
    seen.append(path.stat().st_size if path.is_file() else None)
    time.sleep(0.05)
run, task = (out / kind / name.removeprefix("name=") for kind in ("runs", "tasks"))
task.mkdir(parents=True)
outputs = {{}}
if "refused" not in name:
    run.mkdir(parents=True)
    (run / "map.ot").write_text("map")
    outputs["map.ot"] = {{"bytes": 3}}
(task / "log.txt").write_text("")
is_whole = set(seen) == {{1000000}}
record = {{"source": source, "options": options, "settings_sha256": "", "version": "", "class": "ok" if is_whole else "failed"}}
record |= {{"reason": str(seen), "outputs": outputs, "metrics": None, "peak_rss_bytes": None}}
(task / "task.json").write_text(json.dumps(record))
"""


@pytest.fixture
def place(tmp_path):
    """A folder with a program, a recording and room for scratch and results."""
    program = tmp_path / "program"
    program.write_text(PROGRAM.format(python=sys.executable))
    program.chmod(0o755)
    (tmp_path / "phone.mp4").write_bytes(bytes(1_000_000))
    (tmp_path / "out").mkdir()
    return tmp_path


def job(place: Path) -> Job:
    return Job(f"file://{place}/out", str(place / "scratch"), str(place / "program"), (), str(place), 1)


def task(place: Path, name: str, looks: int, local: str = "sources/phone.mp4") -> Task:
    plan = {"options": [str(looks)], "settings_sha256": "", "version": ""}
    return Task(name, f"file://{place}/phone.mp4", str(place / "scratch" / local), str(looks), plan)


def send_record(queue, task, job, delay):
    time.sleep(delay)
    try:
        queue.put((task.name, carry_out(task, job)))
    except BaseException as error:
        queue.put((task.name, repr(error)))


def at_once(*calls):
    """The records of tasks that are carried out by processes of their own, each after a delay."""
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    processes = [context.Process(target=send_record, args=(queue, *call)) for call in calls]
    for process in processes:
        process.start()
    records = [queue.get(timeout=60) for _ in processes]
    for process in processes:
        process.join()
    return records


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3])
def test_one_address_twice_with_other_options(place, delay):
    records = at_once((task(place, "a", 2), job(place), 0), (task(place, "b", 20), job(place), delay))
    assert {name: record["class"] for name, record in records} == {"a": "ok", "b": "ok"}, records
    assert not any((place / "scratch" / "sources").rglob("*.mp4")), "nothing is left"


def test_one_name_twice_is_done_one_after_the_other(place):
    records = at_once((task(place, "a", 10), job(place), 0), (task(place, "a", 10), job(place), 0.2))
    assert [record["class"] for _, record in records] == ["ok", "ok"], records


def test_a_run_that_never_began_has_a_record_all_the_same(place):
    record = carry_out(task(place, "refused", 1), job(place))
    assert record["outputs"] == {}
    assert Store(job(place).out).read("tasks/refused/task.json") is not None


def test_a_file_beside_the_results_is_removed_only_as_it_was_written(place):
    beside, store = place / "run.mcap", Store(job(place).out)
    for content, stays in [(b"as it was", False), (b"of somebody else", True)]:
        digest = hashlib.sha256(b"as it was").hexdigest()
        earlier = {"class": "failed", "files": {str(beside): {"bytes": 9, "sha256": digest}}}
        store.write(json.dumps(earlier).encode(), "tasks/a/task.json")
        beside.write_bytes(content)
        carry_out(task(place, "a", 1), job(place))
        assert beside.exists() == stays


def test_what_can_pass_is_done_again_and_what_is_done_stays(place):
    first = task(place, "a", 1)
    record = carry_out(first, job(place))
    # as the driver plans it
    first = Task(first.name, first.source, record["source"], first.options, first.plan)
    store = Store(job(place).out)
    assert finished(first, store, ()) == record
    for name in ("failed", "crashed", "killed", "no-space", "interrupted", "unfinished"):
        store.write(json.dumps(record | {"class": name}).encode(), "tasks/a/task.json")
        assert finished(first, store, ()) is None, name
    for name in ("ok", "lost", "not-started", "bad-input", "timeout"):
        store.write(json.dumps(record | {"class": name}).encode(), "tasks/a/task.json")
        assert finished(first, store, ()) is not None, name
    (place / "phone.mp4").unlink()
    assert finished(first, store, ()) is not None, "the recording is gone, what came of it is not"
    (place / "phone.mp4").write_bytes(bytes(1_000_001))
    assert finished(first, store, ()) is None, "another recording"


def test_the_scratch_folder_is_made_private(place):
    os.umask(0o022)
    carry_out(task(place, "a", 1), job(place))
    assert (place / "scratch").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(("kind", "said"), [("link", "is a link"), ("open", "open to others"), ("file", "no folder")])
def test_a_scratch_folder_that_is_not_ours_alone_is_refused(place, kind, said):
    scratch, victim = place / "scratch", place / "victim"
    victim.mkdir(mode=0o700)
    if kind == "link":
        scratch.symlink_to(victim)
    elif kind == "open":
        scratch.mkdir()
        scratch.chmod(0o755)
    else:
        scratch.write_text("")
    with pytest.raises(Unsafe, match=said):
        carry_out(task(place, "a", 1), job(place))
    assert not any(victim.iterdir())


def test_a_scratch_folder_of_another_user_is_refused(place, monkeypatch):
    (place / "scratch").mkdir(mode=0o700)
    monkeypatch.setattr(scratch_folder.os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(Unsafe, match="belongs to the user"):
        carry_out(task(place, "a", 1), job(place))


PLANTED = [(os.symlink, at) for at in ("pids", "pids/a", "lists", "lists/a.tsv", "sources", "sources/a", "out", "sent")]


@pytest.mark.parametrize(("link", "planted"), [*PLANTED, (os.link, "pids/a"), (os.link, "lists/a.tsv")])
def test_nothing_planted_in_it_is_followed(place, link, planted):
    scratch, victim = place / "scratch", place / "victim"
    is_file = planted in ("pids/a", "lists/a.tsv")
    scratch.mkdir(mode=0o700)
    if is_file:
        victim.write_text("precious")
    else:
        victim.mkdir()
    at = scratch / planted
    at.parent.mkdir(exist_ok=True)
    link(victim, at)
    with pytest.raises(Unsafe, match=r"is a link|not a file of ours"):
        carry_out(task(place, "a", 1), job(place))
    assert victim.read_text() == "precious" if is_file else not any(victim.iterdir())


def test_what_a_terminal_obeys_is_shown() -> None:
    said = printable("s3://a/\x1b[2J\u202e\x9b31m: class \x07 of Küche\n")
    assert said == "s3://a/\\u001b[2J\\u202e\\u009b31m: class \\u0007 of Küche\n"
