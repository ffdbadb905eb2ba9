"""Recordings under Ray with an object store: as fast as its workers allow, and no worse for killed ones.

    python bar.py MONOGRID WORK [--recordings N] [--frames N] [--shared FOLDER]

WORK is a folder for everything that is made. A server with the protocol of S3 (moto) runs on this computer. Every recording is done by a
plain `monogrid run` first; then all of them by one worker, by two, and by two of which one is killed (kill -9) three times. What the
store holds afterwards must be what the plain runs wrote, byte for byte, but for the files that hold times.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import obstore
from obstore.store import from_url

PORT = 5817
BUCKET = "recordings"
ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_REGION": "us-east-1",
    "AWS_ENDPOINT_URL": f"http://127.0.0.1:{PORT}",
    "AWS_ALLOW_HTTP": "true",
}
WORLDS = ["living-room", "office", "machine-hall", "corridor-loop"]
SHARED = ["icl-office-kt3", "red-kitchen", "fr1-desk", "tsukuba"]
WITH_TIMES = {"summary.json", "report.html", "frames.csv", "monogrid-manifest.txt"}
KILLS = 3
LEAST_SPEED_UP = 1.6


def piece(source: Path, to: Path, start: int, count: int) -> bool:
    """Some frames of a recording in TUM layout, with its calibration and truth; whether it has so many."""
    listed = [line for line in (source / "rgb.txt").read_text().splitlines() if not line.startswith("#")]
    chosen = listed[start : start + count]
    if len(chosen) < count:
        return False
    to.mkdir(parents=True)
    for line in chosen:
        name = line.split()[1]
        (to / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(source / name, to / name)
    (to / "rgb.txt").write_text("\n".join(chosen) + "\n")
    for name in ["calibration.txt", "groundtruth.txt"]:
        if (source / name).is_file():
            shutil.copyfile(source / name, to / name)
    return True


def make_recordings(args, folder: Path) -> list[Path]:
    """Pieces of built-in worlds and of the shared sequences in turn; those of an earlier call, where there are some."""
    if folder.is_dir():
        return sorted(folder.iterdir())[: args.recordings]
    sources = []
    for world in WORLDS:
        out = args.work / "worlds" / world
        frames = str(args.frames * args.recordings // 4 + args.frames)
        command = [args.monogrid, "synth", world, "--out", str(out), "--size", "320x240", "--frames", "900", "--max-frames", frames]
        subprocess.run([*command, "--truth-resolution", "0.2"], check=True, capture_output=True)
        sources.append(out)
    sources += [args.shared / name for name in SHARED if args.shared and (args.shared / name / "rgb.txt").is_file()]
    made, number = [], 0
    while len(made) < args.recordings and number < 100 * len(sources):
        source, turn = sources[number % len(sources)], number // len(sources)
        to = folder / f"{source.name}-{turn:02}"
        if piece(source, to, turn * args.frames, args.frames):
            made.append(to)
        number += 1
    return made


def plain_runs(args, recordings: list[Path]) -> dict[str, dict[str, bytes]]:
    """What `monogrid run` writes of each."""
    results = {}
    for recording in recordings:
        out = args.work / "plain" / recording.name
        ended = subprocess.run([args.monogrid, "run", str(recording), "--out", str(out), "--threads", "1"], capture_output=True, check=False)
        assert ended.returncode in (0, 3), ended.stderr.decode()
        files = (path for path in out.rglob("*") if path.is_file())
        results[recording.name] = {path.relative_to(out).as_posix(): path.read_bytes() for path in files}
        shutil.rmtree(out)
    return results


def start_server():
    """A server with the protocol of S3, with one bucket."""
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(PORT)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    import boto3

    for _ in range(100):
        try:
            boto3.client("s3", endpoint_url=ENVIRONMENT["AWS_ENDPOINT_URL"]).create_bucket(Bucket=BUCKET)
            return server
        except Exception:  # not there yet
            time.sleep(0.2)
    server.kill()
    raise SystemExit("the server of the object store does not start")


def kill_workers(scratch: Path, killed: list[str], stop: threading.Event) -> None:
    """Kills the worker of a recording at work, three times, in the middle of its run."""
    while len(killed) < KILLS and not stop.wait(1.0):
        at_work = sorted((scratch / "pids").glob("*")) if (scratch / "pids").is_dir() else []
        for file in at_work:
            runs = scratch / "out" / "runs" / file.name
            if file.name not in killed and runs.is_dir():
                try:
                    os.kill(int(file.read_text()), signal.SIGKILL)
                except (OSError, ValueError):
                    continue
                killed.append(file.name)
                break


def batch(args, recordings: list[Path], workers: int, name: str, kills: bool) -> tuple[float, list[str]]:
    """Does all of them under Ray; wall time, and whose workers were killed."""
    scratch = args.work / f"scratch-{name}"
    lines = [f"s3://{BUCKET}/in/{recording.name}" for recording in recordings]
    (args.work / "list.tsv").write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "monogrid_ray", str(args.work / "list.tsv"), "--out", f"s3://{BUCKET}/{name}", "--workers", str(workers)]
    command += ["--program", str(args.monogrid), "--scratch", str(scratch)]
    killed, stop = [], threading.Event()
    killer = threading.Thread(target=kill_workers, args=(scratch, killed, stop))
    if kills:
        killer.start()
    begin = time.monotonic()
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.monotonic() - begin
    stop.set()
    if kills:
        killer.join()
    print(ended.stdout.strip() or ended.stderr[-2000:], flush=True)
    assert ended.returncode == 0, ended.stderr[-4000:]
    return seconds, killed


def compare(name: str, plain: dict[str, dict[str, bytes]]) -> int:
    """How many files the store holds; stops where one differs from what a plain run wrote."""
    store, count = from_url(f"s3://{BUCKET}"), 0
    for recording, files in plain.items():
        prefix = f"{name}/runs/{recording}"
        found = [entry["path"] for chunk in obstore.list(store, prefix=prefix) for entry in chunk]
        assert {path.removeprefix(prefix + "/") for path in found} == set(files), f"{recording}: other files"
        for path in found:
            short = path.removeprefix(prefix + "/")
            content = bytes(obstore.get(store, path).bytes())
            assert short in WITH_TIMES or content == files[short], f"{recording}: {short} differs"
            count += 1
        record = json.loads(bytes(obstore.get(store, f"{name}/tasks/{recording}/task.json").bytes()))
        assert record["class"] in ("ok", "lost", "not-started"), record["reason"]
    return count


def main() -> None:
    """Measures and compares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("monogrid", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--shared", type=Path)
    args = parser.parse_args()
    args.monogrid, args.work = args.monogrid.resolve(), args.work.resolve()
    os.environ.update(ENVIRONMENT)
    recordings = make_recordings(args, args.work / "recordings")
    print(f"{len(recordings)} recordings of {args.frames} frames", flush=True)
    plain = plain_runs(args, recordings)
    server = start_server()
    try:
        store = from_url(f"s3://{BUCKET}")
        for recording in recordings:
            for path in (path for path in recording.rglob("*") if path.is_file()):
                obstore.put(store, f"in/{recording.name}/{path.relative_to(recording).as_posix()}", path)
        one, _ = batch(args, recordings, 1, "one", kills=False)
        print(f"one worker: {one:.1f} s, {compare('one', plain)} files as plain runs write them", flush=True)
        two, _ = batch(args, recordings, 2, "two", kills=False)
        print(f"two workers: {two:.1f} s, {compare('two', plain)} files as plain runs write them", flush=True)
        _, killed = batch(args, recordings, 2, "killed", kills=True)
        print(f"workers killed: {len(killed)}, {compare('killed', plain)} files as plain runs write them", flush=True)
        again, _ = batch(args, recordings, 2, "killed", kills=False)
        print(f"the same call again: {again:.1f} s", flush=True)
    finally:
        server.kill()
    assert len(killed) == KILLS, f"only {len(killed)} workers could be killed"
    ratio = one / two
    print(f"two workers are {ratio:.2f} times one: {'holds' if ratio >= LEAST_SPEED_UP else 'DOES NOT HOLD'} (at least {LEAST_SPEED_UP})")
    sys.exit(0 if ratio >= LEAST_SPEED_UP else 3)


if __name__ == "__main__":
    main()
