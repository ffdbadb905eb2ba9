"""Folders that are local, or in an object store (s3://, gs://, az://, file://), by the library obstore.

Credentials and endpoints come from the usual variables of the environment (AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL, ...).
"""

import hashlib
import os
import tempfile
from pathlib import Path
from urllib.parse import urlsplit

import obstore
from obstore.store import from_url

#: Bytes that are read at once.
CHUNK = 8 << 20


def is_url(text: str) -> bool:
    """Whether a source or destination is in an object store."""
    return "://" in text


class Store:
    """What lies below an address: names are relative to it, with `/`."""

    def __init__(self, url: str):
        parts = urlsplit(url)
        self.url = url
        self.prefix = parts.path.strip("/")
        if parts.scheme == "file":
            # the root is the folder of all
            self.store = from_url("file:///")
        else:
            # the bucket, so that an object and a "folder" are looked for alike
            self.store = from_url(f"{parts.scheme}://{parts.netloc}")

    def _key(self, name: str) -> str:
        return f"{self.prefix}/{name}".strip("/")

    def files(self, below: str = "") -> list[dict]:
        """Objects below a name, or the one of that name: relative name (empty for the one), size, and what identifies their content."""
        key = self._key(below)
        found = []
        for chunk in obstore.list(self.store, prefix=key or None):
            for entry in chunk:
                found.append(_entry(entry, entry["path"].removeprefix(key).lstrip("/")))
        if not found and key:
            try:
                found.append(_entry(obstore.head(self.store, key), ""))
            except FileNotFoundError:
                pass
        return sorted(found, key=lambda entry: entry["name"])

    def read(self, name: str) -> bytes | None:
        """The bytes of an object; None where there is none."""
        try:
            return bytes(obstore.get(self.store, self._key(name)).bytes())
        except FileNotFoundError:
            return None

    def fetch(self, name: str, to: Path) -> None:
        """Writes an object into a file, which appears whole or not at all."""
        to.parent.mkdir(parents=True, exist_ok=True)
        descriptor, part = tempfile.mkstemp(prefix=".", suffix=".part", dir=to.parent)
        try:
            with open(descriptor, "wb") as file:
                for chunk in obstore.get(self.store, self._key(name)).stream(min_chunk_size=CHUNK):
                    file.write(chunk)
            os.replace(part, to)
        except BaseException:
            os.unlink(part)
            raise

    def send(self, path: Path, name: str) -> None:
        """Writes a file as an object, which appears whole or not at all."""
        with open(path, "rb") as file:
            obstore.put(self.store, self._key(name), file)

    def write(self, content: bytes, name: str) -> None:
        """Writes bytes as an object."""
        obstore.put(self.store, self._key(name), content)

    def remove(self, name: str) -> None:
        """Removes an object."""
        obstore.delete(self.store, self._key(name))


def _entry(entry: dict, name: str) -> dict:
    content = entry.get("e_tag") or str(entry["last_modified"])
    return {"name": name, "bytes": entry["size"], "content": content}


def stamp(source: str) -> str | None:
    """Hash of names, sizes and what identifies the content of all that a source holds; None where there is nothing."""
    if is_url(source):
        files = Store(source).files()
    else:
        files = [_local(path, source) for path in _files_below(Path(source))]
    if not files:
        return None
    lines = [f"{file['name']}\t{file['bytes']}\t{file['content']}\n" for file in files]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _files_below(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(file for file in path.rglob("*") if file.is_file())
    return [path] if path.is_file() else []


def _local(path: Path, source: str) -> dict:
    status = path.stat()
    return {"name": os.path.relpath(path, source), "bytes": status.st_size, "content": str(status.st_mtime_ns)}


def fetch_source(url: str, to: Path) -> None:
    """Fetches a recording, one object or all that lie below its address. FileNotFoundError where there is nothing."""
    store = Store(url)
    files = store.files()
    if not files:
        raise FileNotFoundError(f"there is nothing at {url}")
    for file in files:
        # names come from outside: they stay in the folder
        if ".." in Path(file["name"]).parts:
            raise ValueError(f"{url} holds the name {file['name']!r}, which leads out of it")
        store.fetch(file["name"], to / file["name"] if file["name"] else to)
