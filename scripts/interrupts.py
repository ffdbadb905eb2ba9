#!/usr/bin/env python3
"""How soon a run ends after Ctrl-C, in every state of every source.

    scripts/interrupts.py PROGRAM [NAME ...]     all states, or those with one of these words in their names

Prints the time from the interrupt to the end, the exit code and what was saved; fails where it took more than two seconds of
the clock and of the processor (the computer may be busy), or ended by anything but an exit code.
"""

import gzip
import io
import os
import signal
import socket
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
from pathlib import Path

MAX_SECONDS = 2.0
PATIENCE_SECONDS = 60


class Scene:
    """Inputs, made once by the program."""

    def __init__(self, program, folder):
        self.program, self.folder = program, folder
        room = ["synth", "office", "--max-frames", "120", "--size", "320x240", "--out", str(folder / "room")]
        subprocess.run([program, *room], check=True, capture_output=True)
        self.room = folder / "room"

    def without_calibration(self):
        folder = self.folder / "unknown"
        if not folder.exists():
            folder.mkdir()
            (folder / "rgb").symlink_to(self.room / "rgb")
            (folder / "rgb.txt").write_text((self.room / "rgb.txt").read_text())
        return folder

    def earlier(self):
        """A run of the same room."""
        folder = self.folder / "earlier"
        if not folder.exists():
            subprocess.run([self.program, "run", str(self.room), "--out", str(folder)], check=True, capture_output=True)
        return folder

    def archive(self):
        """One that takes seconds to decompress."""
        path = self.folder / "room.tar.gz"
        if not path.exists():
            with gzip.open(path, "wb", compresslevel=1) as packed, tarfile.open(fileobj=packed, mode="w|") as tar:
                noise = os.urandom(1 << 20)
                for number in range(400):
                    info = tarfile.TarInfo(f"{number}.png")
                    info.size = len(noise)
                    tar.addfile(info, io.BytesIO(noise))
        return path

    def y4m(self):
        frame = bytes((x * 7 + y * 13) % 251 for y in range(240) for x in range(320))
        return b"YUV4MPEG2 W320 H240 F30:1 Cmono\n" + (b"FRAME\n" + frame) * 20

    def silent_server(self, answer):
        """The address of a server that says this and nothing more."""
        listener = socket.create_server(("127.0.0.1", 0))
        held = []

        def serve():
            while True:
                stream, _ = listener.accept()
                stream.recv(1000)
                stream.sendall(answer)
                held.append(stream)

        threading.Thread(target=serve, daemon=True).start()
        return f"127.0.0.1:{listener.getsockname()[1]}"

    def ffmpeg(self):
        """A folder with a program `ffmpeg` that never says anything."""
        folder = self.folder / "bin"
        folder.mkdir(exist_ok=True)
        (folder / "ffmpeg").write_text("#!/bin/sh\nexec sleep 100\n")
        (folder / "ffmpeg").chmod(0o755)
        (self.folder / "a.mkv").write_bytes(b"\x1a\x45\xdf\xa3" + bytes(1000))
        return folder, self.folder / "a.mkv"


MJPEG = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n--b\r\n"


def states(scene):
    """Name, arguments, what is said when the state begins (none: at once), seconds after that, standard input, folder of programs."""
    large = ["--size", "1280x960"]
    programs, video = scene.ffmpeg()
    yield "opening an archive", [str(scene.archive()), "--fov", "60"], None, 0.4, None, None
    for after in (0.3, 1.0):
        yield f"first pass, {after} s", [str(scene.without_calibration())], None, after, None, None
    for after in (0.2, 1.0, 2.0):
        yield f"tracking, {after} s", [str(scene.room)], "working size", after, None, None
    yield "tracking large images", [str(scene.room), *large], "working size", 2.0, None, None
    for after in (0.05, 1.0, 3.0):
        yield f"final depth and maps, {after} s", [str(scene.room), *large], "depth and maps of", after, None, None
    yield "at the pace of the camera", [str(scene.room), "--realtime"], "working size", 1.0, None, None
    yield "shown in a browser", [str(scene.room), "--view"], "working size", 1.0, None, None
    yield "in submaps", [str(scene.room), "--submaps=2"], "working size", 2.0, None, None
    yield "reading an earlier map", [str(scene.room), "--continue", str(scene.earlier())], None, 0.1, None, None
    yield "going on with an earlier map", [str(scene.room), "--continue", str(scene.earlier())], "working size", 1.0, None, None
    yield "end of a run", [str(scene.room)], "depth and maps of", 0.0, None, None
    yield "pipe that stalls", ["-", "--fov", "60"], None, 1.5, scene.y4m(), None
    yield "pipe before its header", ["-", "--fov", "60"], None, 1.0, b"YUV4", None
    yield "server that stalls", [f"http://{scene.silent_server(MJPEG)}/", "--fov", "60", "--source-timeout", "0"], None, 1.0, None, None
    yield "server that never answers", [f"http://{scene.silent_server(b'')}/", "--fov", "60", "--source-timeout", "0"], None, 1.0, None, None
    yield "waiting for ffmpeg", [str(video), "--fov", "60"], None, 1.0, None, programs
    yield "waiting for a camera", [f"rtsp://{scene.silent_server(b'')}/x", "--fov", "60", "--source-timeout", "0"], None, 1.0, None, programs


def children_seconds(pid):
    """Processor time of a process so far."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return 0.0


def interrupted(scene, arguments, said, after, given, programs):
    """Seconds of the clock and of the processor from the interrupt to the end, exit code, names of files."""
    with tempfile.TemporaryDirectory(dir=scene.folder) as out:
        out = Path(out, "out")
        path = os.environ["PATH"]
        environment = {**os.environ, "PATH": f"{programs}:{path}" if programs else path}
        child = subprocess.Popen([scene.program, "run", *arguments, "--out", str(out)], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                                 stderr=subprocess.PIPE, text=False, env=environment)
        begun = threading.Event()

        def listen():
            for line in child.stderr:
                if said and said.encode() in line:
                    begun.set()
            begun.set()

        threading.Thread(target=listen, daemon=True).start()
        if given:
            child.stdin.write(given)
            child.stdin.flush()
        if said:
            begun.wait(PATIENCE_SECONDS)
        time.sleep(after)
        if child.poll() is not None:
            return None
        used, begin = children_seconds(child.pid), time.monotonic()
        child.send_signal(signal.SIGINT)
        last = used
        while child.poll() is None and time.monotonic() - begin < PATIENCE_SECONDS:
            last = max(last, children_seconds(child.pid))
            time.sleep(0.01)
        seconds = time.monotonic() - begin
        if child.poll() is None:
            child.kill()
        child.wait()
        child.stdin.close()
        names = sorted(path.name for path in out.iterdir()) if out.is_dir() else []
        kept = [name for name in ("trajectory.txt", "global.ot", "recording.mgk", "report.html", "summary.json") if name in names]
        return seconds, last - used, child.returncode, kept


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program, words = os.path.abspath(sys.argv[1]), sys.argv[2:]
    slow = 0
    with tempfile.TemporaryDirectory(prefix="interrupts-") as folder:
        scene = Scene(program, Path(folder))
        for name, *state in states(scene):
            if words and not any(word in name for word in words):
                continue
            ended = interrupted(scene, *state)
            if ended is None:
                print(f"      {name:32} ended before it was interrupted", flush=True)
                continue
            seconds, used, code, kept = ended
            is_slow = min(seconds, used) > MAX_SECONDS or seconds > 5 * MAX_SECONDS or code not in (0, 4)
            slow += is_slow
            print(f"{'SLOW ' if is_slow else 'ok   '} {name:32} {seconds:5.2f} s ({used:5.2f} s of the processor), code {code}: "
                  f"{', '.join(kept) or 'nothing to save'}", flush=True)
    sys.exit(slow > 0)


if __name__ == "__main__":
    main()
