"""The scratch folder: private, ours, and never followed to somewhere else.

Its default name in the temporary directory is the same on every computer and so can be foreseen: whoever makes it first could read what is
fetched, change it while it is read, or lead what is written to files of ours.
"""

import contextlib
import os
import stat
from pathlib import Path

try:
    import fcntl
except ImportError:  # no locks: two drivers on one computer are then not kept apart
    fcntl = None


class Unsafe(Exception):
    """The scratch folder cannot be trusted: why, and what to do."""


def private_folder(path: Path) -> Path:
    """Makes a folder that only we can enter, where there is none. Unsafe where another one, or anything else, is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mode = own_folder(path)
    if os.name == "posix" and mode & 0o077:
        raise Unsafe(f"{path} is open to others (mode {mode:04o}), expected 0700; see what is in it, then `chmod 700`, or choose another with --scratch")
    return path


def own_folder(path: Path) -> int:
    """Makes a folder of ours in one that is private, where there is none; its mode. Unsafe where anything else is there."""
    with contextlib.suppress(FileExistsError):
        os.mkdir(path, 0o700)
    status = os.lstat(path)
    if stat.S_ISLNK(status.st_mode):
        raise Unsafe(f"{path} is a link, expected a folder of our own; remove it, or choose another with --scratch")
    if not stat.S_ISDIR(status.st_mode):
        raise Unsafe(f"{path} is no folder; remove it, or choose another with --scratch")
    if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
        raise Unsafe(f"{path} belongs to the user {status.st_uid}, expected {os.geteuid()}; choose another folder with --scratch")
    return stat.S_IMODE(status.st_mode)


def open_own(path: Path) -> int:
    """Opens a file of ours for writing, made where there is none; its descriptor. Unsafe where a link or the file of another is there."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        descriptor = os.open(path, flags, 0o600)
    except OSError as error:
        if path.is_symlink():
            raise Unsafe(f"{path} is a link, expected a file of our own; remove it, or choose another folder with --scratch") from error
        raise
    status = os.fstat(descriptor)
    is_ours = not hasattr(os, "geteuid") or status.st_uid == os.geteuid()
    if not (stat.S_ISREG(status.st_mode) and is_ours and status.st_nlink <= 1):
        os.close(descriptor)
        raise Unsafe(f"{path} is not a file of ours alone; remove it, or choose another folder with --scratch")
    return descriptor


def write_own(path: Path, text: str) -> None:
    """Writes a file of ours. Unsafe as `open_own`."""
    with open(open_own(path), "w", encoding="utf-8") as file:
        file.truncate()
        file.write(text)


@contextlib.contextmanager
def held(path: Path):
    """Holds a file of ours against other processes of this computer, waiting for them; it holds the number of this process."""
    with open(open_own(path), "w", encoding="utf-8") as file:
        if fcntl is not None:
            # the lock ends with the process, whatever ends it
            fcntl.flock(file, fcntl.LOCK_EX)
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        finally:
            file.seek(0)
            file.truncate()
