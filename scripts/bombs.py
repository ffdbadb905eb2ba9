#!/usr/bin/env python3
"""Small inputs that ask for much: files of less than 1 MB that hold, or claim to hold, far more.

    scripts/bombs.py PROGRAM [NAME ...]      all, or those with one of these words in their names

Each is given to every command that reads its kind. None may take more than 500 MB of memory or 20 s of
processor time, with the programs that it starts (ffmpeg), end by a signal or panic. KEEP: a folder in
which the inputs stay.
"""

import bz2
import gzip
import hashlib
import io
import os
import resource
import signal
import struct
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
import zlib
from pathlib import Path

MAX_BYTES = 1 << 20
MAX_MEMORY_KB = 500_000
MAX_SECONDS = 20
# A command is ended after this much time of the processor, so that what it takes is known to be too much,
MAX_SECONDS_MEASURED = 2 * MAX_SECONDS
# and after this much on the clock, in case it waits for ever: the machine may be busy.
PATIENCE_SECONDS = 900

BOMBS = {}


def bomb(*commands):
    """Registers a function that writes an input into a folder and returns its path; IN, OUT and DIR stand for that path, a
    path that does not exist and the folder."""

    def register(make):
        BOMBS[make.__name__.replace("_", "-")] = (make, [command.split() for command in commands])
        return make

    return register


# pictures


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, bits=8, colour=0):
    channels = {0: 1, 2: 3, 6: 4}[colour]
    row = bytes(1 + (width * channels * bits + 7) // 8)
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def segment(marker, data):
    return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data


def stuffed(bits):
    bits += "1" * (-len(bits) % 8)
    data = int(bits, 2).to_bytes(len(bits) // 8, "big")
    return data.replace(b"\xff", b"\xff\x00")


def jpeg(width, height):
    """A plain grey one: two bits for each block."""
    blocks = ((width + 7) // 8) * ((height + 7) // 8)
    # one code of one bit in each table, for the value 0
    table = lambda kind: bytes([kind]) + bytes([1] + 15 * [0]) + b"\0"
    return (
        b"\xff\xd8"
        + segment(0xDB, b"\0" + bytes([1] * 64))
        + segment(0xC0, struct.pack(">BHHB", 8, height, width, 1) + b"\1\x11\0")
        + segment(0xC4, table(0x00))
        + segment(0xC4, table(0x10))
        + segment(0xDA, b"\1\1\0\0\x3f\0")
        + bytes(blocks // 4)
        + b"\x3f" * 0
        + stuffed("00" * (blocks % 4) or "1")
        + b"\xff\xd9"
    )


def progressive_jpeg(width, height, scans):
    """A scan for the first coefficient, then many of which each says nothing of all blocks."""
    blocks = ((width + 7) // 8) * ((height + 7) // 8)
    out = (
        b"\xff\xd8"
        + segment(0xDB, b"\0" + bytes([1] * 64))
        + segment(0xC2, struct.pack(">BHHB", 8, height, width, 1) + b"\1\x11\0")
        + segment(0xC4, b"\x00" + bytes([1] + 15 * [0]) + b"\0")
        # end of band of 2^14 blocks and more: 14 bits follow
        + segment(0xC4, b"\x10" + bytes([1] + 15 * [0]) + b"\xe0")
        + segment(0xDA, b"\1\1\0\0\0\x01")
        + bytes(blocks // 8)
        + stuffed("0" * (blocks % 8) or "1")
    )
    run = (1 << 15) - 1
    bits = ("0" + "1" * 14) * (blocks // run + 1)
    for scan in range(scans):
        low = 0 if scan == scans - 1 else 1
        out += segment(0xDA, b"\1\1\0" + bytes([1 + scan % 63, 1 + scan % 63, low])) + stuffed(bits)
    return out + b"\xff\xd9"


def webp(width, height):
    """Lossless and plain: no bit for a pixel."""
    bits, count = 0x2F, 8

    def put(value, length):
        nonlocal bits, count
        bits |= value << count
        count += length

    put(width - 1, 14)
    put(height - 1, 14)
    put(0, 1)  # no opacity
    put(0, 3)  # version
    put(0, 1)  # no transform
    put(0, 1)  # no cache of colours
    put(0, 1)  # one group of codes
    for _ in range(5):
        put(1, 1)  # a simple code
        put(0, 1)  # of one symbol
        put(0, 1)  # of one bit
        put(0, 1)  # 0
    data = bits.to_bytes((count + 7) // 8, "little") + b"\0" * 8
    data += b"\0" * (len(data) % 2)
    body = b"WEBPVP8L" + struct.pack("<I", len(data)) + data
    return b"RIFF" + struct.pack("<I", len(body)) + body


def tiff(width, height, bits=8):
    data = zlib.compress(bytes(width * height * bits // 8), 9)
    entries = [
        (256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, bits), (259, 3, 1, 8), (262, 3, 1, 1),
        (273, 4, 1, 8), (277, 3, 1, 1), (278, 4, 1, height), (279, 4, 1, len(data)),
    ]
    data += b"\0" * (len(data) % 2)
    out = b"II*\0" + struct.pack("<I", 8 + len(data)) + data + struct.pack("<H", len(entries))
    for tag, kind, count, value in entries:
        out += struct.pack("<HHI", tag, kind, count) + (struct.pack("<HH", value, 0) if kind == 3 else struct.pack("<I", value))
    return out + struct.pack("<I", 0)


def images(folder, picture, ending, count=None):
    count = count or max(1, min(2000, (MAX_BYTES - 60_000) // len(picture)))
    folder = folder / "images"
    folder.mkdir()
    for index in range(count):
        (folder / f"{index:04}.{ending}").write_bytes(picture)
    return folder


IMAGE_COMMANDS = ["check IN", "check IN --fov 60", "run IN --fov 60 --out OUT", "run IN --out OUT", "thesis vocabulary IN --every 1 --threads 8 --out OUT", "calibrate IN --board 9x6"]
SEQUENCE = IMAGE_COMMANDS[:4]


@bomb(*IMAGE_COMMANDS)
def plain_png(folder):
    return images(folder, png(3500, 3500), "png")


@bomb(*SEQUENCE)
def plain_png_of_one_bit(folder):
    return images(folder, png(3500, 3500, 1), "png")


@bomb("check IN --fov 60", "run IN --fov 60 --out OUT", "thesis vocabulary IN --every 1 --threads 8 --out OUT")
def plain_png_in_colour_of_16_bits(folder):
    return images(folder, png(2900, 2900, 16, 6), "png", 8)


@bomb(*SEQUENCE)
def plain_jpeg(folder):
    return images(folder, jpeg(3500, 3500), "jpg")


@bomb(*SEQUENCE)
def jpeg_of_many_scans(folder):
    return images(folder, progressive_jpeg(3500, 3500, 1000), "jpg")


@bomb(*SEQUENCE)
def jpeg_of_as_many_scans_as_are_read(folder):
    return images(folder, progressive_jpeg(3500, 3500, 95), "jpg")


@bomb(*SEQUENCE)
def plain_webp(folder):
    return images(folder, webp(3500, 3500), "webp")


@bomb(*SEQUENCE)
def plain_tiff(folder):
    return images(folder, tiff(3500, 3500, 16), "tif")


def bmp(width, height, data, bits=8, packing=1):
    colours = bytes(4 * 256) if bits == 8 else bytes(8)
    begin = 54 + len(colours)
    header = struct.pack("<2sIII", b"BM", begin + len(data), 0, begin)
    return header + struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, packing, len(data), 0, 0, 0, 0) + colours + data


@bomb(*SEQUENCE)
def bmp_of_runs(folder):
    row = b"\xff\0" * (3500 // 255) + bytes([3500 % 255, 0]) + b"\0\0"
    return images(folder, bmp(3500, 3500, row * 3500 + b"\0\1"), "bmp")


@bomb(*SEQUENCE)
def bmp_that_ends_at_once(folder):
    return images(folder, bmp(3500, 3500, b"\0\1"), "bmp")


@bomb(*SEQUENCE)
def bmp_of_one_bit(folder):
    return images(folder, bmp(2800, 2800, bytes(2800 * 352), bits=1, packing=0), "bmp")


def rows_png(rows, width):
    """Of these rows, each a byte per pixel."""
    data = zlib.compress(b"".join(b"\0" + row for row in rows), 9)
    header = struct.pack(">IIBBBBB", width, len(rows), 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


@bomb(*IMAGE_COMMANDS, "calibrate IN --aprilgrid 6x6 --out OUT", "calibrate IN --out OUT")
def png_of_a_fine_chessboard(folder):
    rows = [bytes([0, 255][(x // 8 + y // 8) % 2] for x in range(2000)) for y in range(0, 16, 8)]
    return images(folder, rows_png([rows[y // 8 % 2] for y in range(2000)], 2000), "png")


@bomb(*IMAGE_COMMANDS, "calibrate IN --aprilgrid 6x6 --out OUT", "calibrate IN --out OUT")
def png_of_squares_in_squares(folder):
    side = 2000
    ring = lambda x, y: min(x, y, side - 1 - x, side - 1 - y) // 4 % 2
    rows = [bytes(255 * ring(x, y) for x in range(side)) for y in range(side)]
    return images(folder, rows_png(rows, side), "png", 20)


@bomb(*SEQUENCE)
def png_of_large_profiles(folder):
    picture = png(64, 64)
    zeros = zlib.compress(bytes(60 << 20), 9)
    profile = chunk(b"iCCP", b"a\0\0" + zeros) + chunk(b"zTXt", b"a\0\0" + zeros)
    return images(folder, picture[:33] + profile + picture[33:], "png")


@bomb(*SEQUENCE)
def png_in_seven_passes(folder):
    picture = png(3500, 3500)
    header = struct.pack(">IIBBBBB", 3500, 3500, 8, 0, 0, 0, 1)
    # more rows than it needs
    data = zlib.compress(bytes(3500 * 3500 + 4 * 3500), 9)
    picture = picture[:8] + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    return images(folder, picture, "png")


def tiled_tiff(width, height, tile, data, compression):
    across, down = -(-width // tile), -(-height // tile)
    count = across * down
    start = 8 + len(data) + len(data) % 2
    places, lengths = struct.pack(f"<{count}I", *[8] * count), struct.pack(f"<{count}I", *[len(data)] * count)
    entries = [
        (256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 8), (259, 3, 1, compression), (262, 3, 1, 1), (277, 3, 1, 1),
        (322, 4, 1, tile), (323, 4, 1, tile), (324, 4, count, start if count > 1 else 8), (325, 4, count, start + 4 * count if count > 1 else len(data)),
    ]
    table = struct.pack("<H", len(entries))
    for tag, kind, number, value in entries:
        table += struct.pack("<HHI", tag, kind, number) + (struct.pack("<HH", value, 0) if kind == 3 else struct.pack("<I", value))
    at = start + 8 * count
    return b"II*\0" + struct.pack("<I", at) + data + bytes(len(data) % 2) + places + lengths + table + bytes(4)


@bomb(*SEQUENCE)
def tiff_whose_tiles_are_one(folder):
    return images(folder, tiled_tiff(3456, 3456, 16, zlib.compress(bytes(256), 9), 8), "tif", 2)


@bomb(*SEQUENCE)
def tiff_of_one_huge_tile(folder):
    return images(folder, tiled_tiff(64, 64, 16_000, zlib.compress(bytes(16_000 * 16_000), 9), 8), "tif", 3)


@bomb(*SEQUENCE)
def tiff_of_packed_bits(folder):
    # 128 times the same byte in two
    return images(folder, tiled_tiff(3456, 3456, 3456, b"\x81\0" * (3456 * 3456 // 128), 32773), "tif")


@bomb("check IN --fov 60", "run IN --fov 60 --out OUT", "batch IN --out OUT --timeout 60")
def many_files_of_nothing(folder):
    return images(folder, b"\x89PNG\r\n\x1a\n", "png", 60_000)


@bomb("check IN --fov 60", "run IN --fov 60 --out OUT")
def times_far_apart(folder):
    target = images(folder, png(320, 240), "png", 3)
    lines = "".join(f"{n * n * n * 1e5:.6f} {n % 3:04}.png\n" for n in range(40))
    (target / "rgb.txt").write_text(lines)
    return target


@bomb("check IN --fov 60", "run IN --fov 60 --out OUT")
def huge_headers(folder):
    target = images(folder, png(16, 16), "png", 1)
    giant = chunk(b"IHDR", struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 8, 6, 0, 0, 0))
    (target / "0001.png").write_bytes(b"\x89PNG\r\n\x1a\n" + giant)
    (target / "0002.jpg").write_bytes(jpeg(64, 64).replace(struct.pack(">HH", 64, 64), b"\xff\xff\xff\xff"))
    (target / "0003.pgm").write_bytes(b"P5\n4000000000 4000000000\n255\n")
    (target / "0004.webp").write_bytes(webp(16384, 16384))
    (target / "0005.tif").write_bytes(tiff(64, 64).replace(struct.pack("<HHII", 256, 4, 1, 64), struct.pack("<HHII", 256, 4, 1, 2**32 - 1)))
    return target


@bomb(*SEQUENCE)
def list_that_repeats_an_image(folder):
    target = images(folder, png(3500, 3500), "png", 1)
    lines = "".join(f"{index / 30:.6f} 0000.png\n" for index in range(40_000))
    (target / "rgb.txt").write_text(lines)
    return target


# archives


@bomb(*IMAGE_COMMANDS)
def zip_of_plain_images(folder):
    path = folder / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for index in range(60):
            archive.writestr(f"{index:04}.png", png(3500, 3500))
    return path


@bomb("check IN --fov 60", "run IN --fov 60 --out OUT")
def zip_whose_entries_are_one(folder):
    picture = png(3500, 3500, 1)
    name = b"0000.png"
    crc = zlib.crc32(picture)
    local = struct.pack("<IHHHHHIIIHH", 0x04034B50, 20, 0, 0, 0, 33, crc, len(picture), len(picture), len(name), 0) + name + picture
    count, central = 12_000, b""
    for index in range(count):
        name = b"%04d.png" % index if index < 10_000 else b"%08d.png" % index
        central += struct.pack("<IHHHHHHIIIHHHHHII", 0x02014B50, 20, 20, 0, 0, 0, 33, crc, len(picture), len(picture), len(name), 0, 0, 0, 0, 0, 0) + name
    path = folder / "a.zip"
    path.write_bytes(local + central + struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, count, count, len(central), len(local), 0))
    return path


@bomb(*IMAGE_COMMANDS)
def zip_of_folders_in_folders(folder):
    path = folder / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/" * 32_000 + "0.png", png(16, 16))
    return path


def tar_bytes(picture, count):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        for index in range(count):
            info = tarfile.TarInfo(f"{index:05}.png")
            info.size = len(picture)
            archive.addfile(info, io.BytesIO(picture))
    return out.getvalue()


@bomb(*IMAGE_COMMANDS)
def tar_of_plain_images(folder):
    path = folder / "a.tar"
    path.write_bytes(tar_bytes(png(3500, 3500, 1), 250))
    return path


@bomb(*SEQUENCE)
def tgz_of_plain_images(folder):
    path = folder / "a.tgz"
    path.write_bytes(gzip.compress(tar_bytes(png(3500, 3500, 1), 10_000)))
    return path


@bomb("check IN --fov 60")
def tgz_of_nothing(folder):
    path = folder / "a.tar.gz"
    data = gzip.compress(bytes(64 << 20))
    path.write_bytes(data * 15)
    return path


@bomb("check IN --fov 60")
def zip_of_many_names(folder):
    path = folder / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for index in range(9_000):
            archive.writestr(f"{index}.txt", b"")
    return path


# maps


def octree(header, cells, encode):
    """A tree with these cells (16 bits each) as leaves, in the order of OctoMap's files."""
    out = bytearray(header)

    def node(cells, depth):
        children = {}
        for x, y, z in cells:
            bit = 15 - depth
            octant = (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2
            children.setdefault(octant, []).append((x, y, z))
        encode(out, children, depth)
        for octant in sorted(children):
            if depth < 15:
                node(children[octant], depth + 1)
            else:
                encode(out, None, 16)

    node(cells, 0)
    return bytes(out)


def bt(cells):
    def encode(out, children, depth):
        if children is None:
            return
        # a free leaf: 01, an occupied one: 10 (lowest bit first), a node with children: 11
        kind = 2 if depth == 15 else 3
        out += sum(kind << 2 * octant for octant in children).to_bytes(2, "little")

    return octree(b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.05\ndata\n", cells, encode)


def ot(cells):
    def encode(out, children, depth):
        mask = sum(1 << octant for octant in children or {})
        out += struct.pack("<fB", 0.85, mask)

    return octree(b"# Octomap OcTree file\nid OcTree\nsize 1\nres 0.05\ndata\n", cells, encode)


MAPS = [
    "info IN", "convert IN OUT.bt", "convert IN OUT.ply", "convert IN OUT.mgo", "mesh IN OUT.ply", "project IN OUT.pgm",
    "project IN OUT.pgm --min-height=-2000 --max-height 2000", "slice IN OUT", "distances IN OUT.npy",
    "plan IN 0,0,0 1,1,1 --robot-radius 0.2", "merge IN IN --out OUT.ot", "diff IN IN", "evaluate map IN IN",
    "evaluate paths IN IN", "crop IN OUT.ot --min=-9999,-9999,-9999 --max 9999,9999,9999", "view IN --html OUT.html",
    "view IN --png OUT.png", "transform IN OUT.ot --sim3 DIR/turn.txt",
]


def write_map(folder, name, data):
    (folder / "turn.txt").write_text("1 0.1 0.2 0.3 0.1825742 0.3651484 0.5477226 0.7302967\n")
    path = folder / name
    path.write_bytes(data)
    return path


def other_sizes(folder):
    """Maps of small and large cells beside a map, and motions that make it small and large."""
    for name, size in (("small", b"1e-6"), ("large", b"1000")):
        (folder / f"{name}.bt").write_bytes(bt([(32_768 + x, 32_768, 32_768) for x in range(64)]).replace(b"res 0.05", b"res " + size))
    (folder / "grow.txt").write_text("100000 0 0 0 0 0 0 1\n")
    (folder / "shrink.txt").write_text("0.00001 0 0 0 0 0 0 1\n")


BESIDE = [f"{command} {order}" for command in ("evaluate map", "evaluate paths", "diff", "merge --out OUT.ot")
          for order in ("IN DIR/small.bt", "IN DIR/large.bt", "DIR/small.bt IN", "DIR/large.bt IN")]
BESIDE += [f"transform IN OUT.ot --sim3 DIR/{motion}.txt{more}" for motion in ("grow", "shrink", "turn") for more in ("", " --resolution 0.05")]


@bomb(*BESIDE)
def map_of_another_size(folder):
    other_sizes(folder)
    return write_map(folder, "a.bt", bt([(32_768 + x, 32_768 + y, 32_768) for x in range(30) for y in range(30)]))


@bomb(*BESIDE)
def room_of_another_size(folder):
    other_sizes(folder)
    return write_map(folder, "a.bt", room(6))


@bomb(*MAPS)
def bt_of_two_corners(folder):
    return write_map(folder, "a.bt", bt([(0, 0, 0), (65535, 65535, 65535)]))


@bomb(*MAPS)
def ot_of_far_cells(folder):
    cells = [(n * 97 % 65536, n * 7919 % 65536, n * 104_729 % 65536) for n in range(9000)]
    return write_map(folder, "a.ot", ot(cells))


@bomb(*MAPS)
def bt_of_far_cells(folder):
    cells = [(n * 97 % 65536, n * 7919 % 65536, n * 104_729 % 65536) for n in range(24_000)]
    return write_map(folder, "a.bt", bt(cells))


@bomb(*MAPS)
def bt_of_far_cells_in_a_plane(folder):
    cells = [(n * 97 % 65536, n * 7919 % 65536, 32_768) for n in range(24_000)]
    return write_map(folder, "a.bt", bt(cells))


@bomb(*MAPS)
def bt_of_a_chessboard(folder):
    # leaves of the last level, every second one occupied, the others free
    header = b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.05\ndata\n"
    depth = 7

    def node(level):
        return b"\x99\x66" if level == 1 else b"\xff\xff" + node(level - 1) * 8

    # down to cubes of 128 cells
    data = header + bytes([3, 0]) * (16 - depth) + node(depth)
    return write_map(folder, "a.bt", data[:MAX_BYTES])


@bomb(*MAPS)
def bt_of_full_cubes(folder):
    # nodes of 32 cells, occupied and free by turns
    header = b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.05\ndata\n"
    node = b"\xff\xff" + b"\x99\x66" * 8
    return write_map(folder, "a.bt", header + bytes([3, 0]) * 9 + node)


def room(cubes):
    """Cubes of 128 cells of free space, side by side, in 90 bytes."""
    node = lambda kinds: sum(kind << 2 * octant for octant, kind in enumerate(kinds)).to_bytes(2, "little")
    header = b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.05\ndata\n"
    path = node([0] * 7 + [3]) + node([3] + [0] * 7) * 7
    return header + path + node([3] * cubes + [0] * (8 - cubes)) + node([1] * 8) * cubes


ROOMS = MAPS + ["plan IN 1,1,1 5,5,12 --robot-radius 0.2", "plan IN 1,1,1 5,5,12 --robot-radius 0.2 --through-unknown", "evaluate paths IN IN --pairs 100000"]


@bomb(*ROOMS)
def bt_of_a_free_cube(folder):
    return write_map(folder, "a.bt", room(1))


@bomb(*ROOMS)
def bt_of_a_free_room(folder):
    return write_map(folder, "a.bt", room(6))


class Coder:
    """The arithmetic coder of `.mgo` files."""

    def __init__(self):
        self.low, self.high, self.out = 0, 2**32 - 1, bytearray()
        self.contexts = {}

    def bit(self, context, bit):
        zero = self.contexts.get(context, 2048)
        middle = self.low + ((self.high - self.low) * zero >> 12)
        if bit:
            self.low = middle + 1
            zero -= zero >> 5
        else:
            self.high = middle
            zero += (4096 - zero) >> 5
        self.contexts[context] = zero
        while (self.low ^ self.high) >> 24 == 0:
            self.out.append(self.high >> 24)
            self.low = self.low << 8 & 0xFFFFFFFF
            self.high = (self.high << 8 | 255) & 0xFFFFFFFF


def mgo(folder, num_chunks):
    """Columns of bricks that are occupied as a whole."""
    origin = 1 << 20
    header = b"MGRIDMAP" + struct.pack("<IIdffdQI", 1, 0, 0.05, -2.0, 3.5, 0.5, num_chunks * 1024, 0)
    out = header + struct.pack("<I", zlib.crc32(header))
    coder = Coder()
    for index in range(1024):
        coder.bit("uniform", 1)
        if index == 0:
            coder.bit("x0", 0)
            coder.bit("c1", 1)
            coder.bit("c2", 0)
        else:
            coder.bit("x", 1)
    code = bytes(coder.out) + struct.pack(">I", coder.high)
    for number in range(num_chunks):
        key = (origin + number // 30 << 42) | (origin + number % 30 << 21) | (origin - 512)
        start = bytearray()
        while key >= 128:
            start.append(key & 127 | 128)
            key >>= 7
        data = bytes(start) + bytes([key]) + bytes(1023) + code
        head = struct.pack("<III", 1024, len(data), zlib.crc32(data))
        out += head + struct.pack("<I", zlib.crc32(head)) + data
    return write_map(folder, "a.mgo", out)


@bomb(*MAPS)
def mgo_of_full_bricks(folder):
    return mgo(folder, 870)


@bomb(*MAPS)
def mgo_of_as_many_bricks_as_are_read(folder):
    return mgo(folder, 23)


# recordings

RECORDINGS = [
    "map IN --out OUT.ot", "map IN --out OUT.ot --set mapping.quality=fast", "view IN --html OUT.html", "rescale IN --scale-from factor=2 --out OUT",
    "evaluate depth IN DIR", "merge-runs IN IN --out OUT", "sweep IN --resolutions 0.4 --out OUT", "run IN --out OUT",
    "run --continue IN DIR --fov 60 --out OUT",
]


def record(kind, payload):
    head = b"RMGK" + struct.pack("<III", kind, len(payload), zlib.crc32(payload))
    return head + struct.pack("<I", zlib.crc32(head)) + payload


def camera(width, height):
    return struct.pack("<ddddII", width, width, width / 2, height / 2, width, height)


def session(width, height):
    return camera(width, height) + b"\0" + struct.pack("<Q", 0) + struct.pack("<III", 0, 0, 0)


def pose(number):
    return struct.pack("<8d", 1, number * 0.01, 0, 0, 0, 0, 0, 1)


def keyframe(number, width, height, encoding, image, pixels):
    out = struct.pack("<IQQ", number, number, number * 33_000_000) + bytes([encoding])
    out += struct.pack("<III", width, height, len(image)) + image
    return out + struct.pack("<I", len(pixels)) + b"".join(struct.pack("<HHff", *pixel) for pixel in pixels)


def mgk(keyframes, width, height):
    out = b"monogrid" + struct.pack("<II", 1, 0) + record(1, session(width, height))
    for payload in keyframes:
        out += record(2, payload)
    poses = b"".join(struct.pack("<I", n) + pose(n) for n in range(len(keyframes)))
    return out + record(4, struct.pack("<QI", 1, len(keyframes)) + poses)


PIXELS = [(x * 9 % 320, x * 7 % 240, 1.0, 0.01) for x in range(200)]


@bomb(*RECORDINGS)
def mgk_of_plain_images(folder):
    # as large as is believed
    side = 1900
    picture = png(side, side)
    picture = picture[:-12] + chunk(b"tEXt", b"a\0" + b"b" * (side * side // 64 - len(picture))) + picture[-12:]
    path = folder / "a.mgk"
    path.write_bytes(mgk([keyframe(n, side, side, 2, picture, PIXELS) for n in range(16)], side, side))
    return path


@bomb(*RECORDINGS)
def mgk_of_a_huge_camera(folder):
    path = folder / "a.mgk"
    path.write_bytes(mgk([keyframe(n, 0, 0, 0, b"", PIXELS) for n in range(300)], 65_000, 65_000))
    return path


@bomb(*RECORDINGS)
def mgk_of_one_large_image(folder):
    side = 8000
    picture = png(side, side)
    picture = picture[:-12] + chunk(b"tEXt", b"a\0" + b"b" * (side * side // 64 - len(picture))) + picture[-12:]
    path = folder / "a.mgk"
    path.write_bytes(mgk([keyframe(0, side, side, 2, picture, PIXELS)], side, side))
    return path


@bomb(*RECORDINGS)
def mgk_of_far_points(folder):
    path = folder / "a.mgk"
    pixels = [(x, y, 1e-7, 1e-18) for x in range(0, 320, 2) for y in range(0, 240, 2)]
    path.write_bytes(mgk([keyframe(n, 0, 0, 0, b"", pixels) for n in range(4)], 320, 240))
    return path


@bomb(*RECORDINGS)
def mgk_of_many_keyframes(folder):
    path = folder / "a.mgk"
    path.write_bytes(mgk([keyframe(n, 0, 0, 0, b"", PIXELS[:3]) for n in range(4500)], 320, 240))
    return path


def noise(width, height, seed):
    state, out = seed, bytearray()
    for _ in range(width * height):
        state = (state * 1_103_515_245 + 12_345) & 0x7FFFFFFF
        out.append(state >> 16 & 255)
    return bytes(out)


@bomb(*RECORDINGS)
def mgk_of_many_small_images(folder):
    side = (80, 60)
    pixels = [(x, y, 0.5 + x / 200, 0.01) for x in range(4, 76, 9) for y in range(4, 56, 9)]
    frames = [keyframe(n, *side, 1, noise(*side, n // 2), pixels) for n in range(180)]
    path = folder / "a.mgk"
    path.write_bytes(mgk(frames, *side))
    return path


@bomb("map IN --out OUT.ot", "info IN", "view IN --html OUT.html", "map DIR/submaps.json --out OUT.ot")
def mgs_of_deflated_depth(folder):
    blocks, out = b"", b"mgsubmap" + struct.pack("<II", 1, 0)
    count = 0
    payload = session(320, 240)
    blocks += struct.pack("<IIQII", 1, 2**32 - 1, len(out), len(payload), len(payload)) + b"\0" + hashlib.sha256(payload).digest()
    out += payload
    for number in range(100):
        payload = keyframe(number, 0, 0, 0, b"", [(0, 0, 1.0, 0.01)] * 50_000)
        packed = zlib.compress(payload, 9)
        packed += b"\0" * max(0, len(payload) // 64 + 1 - len(packed))
        if len(out) + len(packed) > MAX_BYTES - 20_000:
            break
        blocks += struct.pack("<IIQII", 2, number, len(out), len(packed), len(payload)) + b"\1" + hashlib.sha256(packed).digest()
        out += packed
        count += 1
    poses = struct.pack("<QI", 1, count) + b"".join(struct.pack("<I", n) + pose(n) for n in range(count))
    blocks += struct.pack("<IIQII", 4, 2**32 - 1, len(out), len(poses), len(poses)) + b"\0" + hashlib.sha256(poses).digest()
    out += poses
    directory = camera(320, 240) + b"\0" + b"\0" + bytes(16) + b"\0" + bytes(48) + struct.pack("<I", count + 2) + blocks
    name = hashlib.sha256(directory).digest()
    out += directory + struct.pack("<QQ", len(out), len(directory)) + name + b"mgs-end\n"
    path = folder / f"{name.hex()}.mgs"
    path.write_bytes(out)
    numbers = "[1.0,0.0,0.0,0.0,0.0,0.0,0.0,1.0]"
    entry = '{"file":"%s","bytes":%d,"keyframes":%d,"world_from_submap":%s,"moved":[]}' % (path.name, len(out), count, numbers)
    table = '{"format":"monogrid submaps","version":1,"pose_revision":1,"submaps":[%s]}' % ",".join([entry] * 3000)
    (folder / "submaps.json").write_text(table)
    return path


@bomb("info IN", "map IN --out OUT.ot")
def submaps_json_in_itself(folder):
    path = folder / "submaps.json"
    path.write_text("[" * 500_000 + "]" * 500_000)
    return path


# bags


def zstd_of_zeros(length):
    blocks, left = [], length
    while left > 0:
        size = min(left, 1 << 17)
        left -= size
        blocks.append(struct.pack("<I", size << 3 | 1 << 1 | (left == 0))[:3] + b"\0")
    # one frame, content size of 8 bytes, window of 128 kB
    return b"\x28\xb5\x2f\xfd" + bytes([0b1100_0000, 7 << 3]) + struct.pack("<Q", length) + b"".join(blocks)


def text(word):
    return struct.pack("<I", len(word)) + word


def mcap(records, chunks, schema=b"sensor_msgs/msg/Image", written=b"cdr"):
    def op(code, body):
        return bytes([code]) + struct.pack("<Q", len(body)) + body

    out = b"\x89MCAP0\r\n" + op(1, text(b"ros2") + text(b"x"))
    out += op(3, struct.pack("<H", 1) + text(schema) + text(b"ros2msg") + text(b""))
    out += op(4, struct.pack("<HH", 1, 1) + text(b"/image") + text(written) + text(b""))
    for body in records:
        out += op(5, struct.pack("<HIQQ", 1, 0, 5, 5) + body)
    for compression, size, data in chunks:
        out += op(6, struct.pack("<QQQI", 0, 0, size, 0) + text(compression) + struct.pack("<Q", len(data)) + data)
    return out + op(15, struct.pack("<I", 0)) + op(2, bytes(20)) + b"\x89MCAP0\r\n"


def cdr_image(width, height, data=None, claims=None):
    out = b"\0\1\0\0" + struct.pack("<iI", 1, 0) + struct.pack("<I", 1) + b"\0"
    out += b"\0" * (-(len(out) - 4) % 4) + struct.pack("<II", height, width) + struct.pack("<I", 6) + b"mono8\0\0"
    out += b"\0" * (-(len(out) - 4) % 4) + struct.pack("<I", width)
    return out + struct.pack("<I", width * height if claims is None else claims) + (data or b"")


BAG = ["check IN --fov 60", "run IN --fov 60 --out OUT"]


@bomb(*BAG)
def mcap_of_zeros(folder):
    path = folder / "a.mcap"
    size = 16 << 20
    path.write_bytes(mcap([], [(b"zstd", size, zstd_of_zeros(size))] * 900)[:MAX_BYTES])
    return path


@bomb(*BAG)
def mcap_of_large_images(folder):
    # an image whose pixels are in the same chunk, as zeros
    width, height = 4000, 4000
    head = bytes([5]) + struct.pack("<Q", 22 + len(cdr_image(width, height)) + width * height) + struct.pack("<HIQQ", 1, 0, 5, 5)
    head += cdr_image(width, height)
    size = len(head) + width * height
    zeros = zstd_of_zeros(width * height)
    raw = struct.pack("<I", len(head) << 3)[:3] + head
    packed = b"\x28\xb5\x2f\xfd" + bytes([0b1100_0000, 7 << 3]) + struct.pack("<Q", size) + raw + zeros[14:]
    path = folder / "a.mcap"
    path.write_bytes(mcap([], [(b"zstd", size, packed)] * (900_000 // len(packed))))
    return path


@bomb(*BAG)
def mcap_of_a_still_video(folder):
    sps, pps, first, again = h264(256, 144)
    start = b"\0\0\0\1"
    packets = [start + start.join((sps, pps, first))] + [start + start.join(again(1000 * k + n + 1) for n in range(1000)) for k in range(30)]
    return video_packets(folder, packets)


@bomb(*BAG)
def mcap_of_a_video_of_slices(folder):
    sps, pps, first, again = h264(256, 144, start=1)
    start = b"\0\0\0\1"
    packets = [start + start.join((sps, pps, first))] + [start + start.join([again(k + 1)] * 1000) for k in range(30)]
    return video_packets(folder, packets)


def video_packets(folder, packets):
    def varint(value):
        out = b""
        while value >= 128:
            out += bytes([value & 127 | 128])
            value >>= 7
        return out + bytes([value])

    def message(time, data):
        stamp = b"\x08" + varint(time // 30) + b"\x10" + varint(time % 30 * 33_000_000)
        return b"\x0a" + varint(len(stamp)) + stamp + b"\x1a" + varint(len(data)) + data + b"\x22\x04h264"

    messages = [message(time, data) for time, data in enumerate(packets)]
    path = folder / "a.mcap"
    path.write_bytes(mcap(messages, [], b"foxglove.CompressedVideo", b"protobuf"))
    return path


@bomb(*BAG)
def mcap_of_many_topics(folder):
    def op(code, body):
        return bytes([code]) + struct.pack("<Q", len(body)) + body

    out = b"\x89MCAP0\r\n" + op(1, text(b"ros2") + text(b"x"))
    for n in range(1, 13_000):
        out += op(3, struct.pack("<H", n) + text(b"a/I") + text(b"") + text(b""))
        out += op(4, struct.pack("<HH", n, n) + text(b"/%d" % n) + text(b"cdr") + text(b""))
    path = folder / "a.mcap"
    path.write_bytes(out + op(15, struct.pack("<I", 0)) + op(2, bytes(20)) + b"\x89MCAP0\r\n")
    return path


def ros1(fields, data):
    header = b"".join(struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value for name, value in fields.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def bag(folder, content, count):
    data = bz2.compress(content, 9)
    record = ros1({b"op": b"\5", b"compression": b"bz2", b"size": struct.pack("<I", len(content))}, data)
    path = folder / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + record * min(count, 900_000 // len(record)))
    return path


@bomb(*BAG)
def bag_of_bz2_zeros(folder):
    return bag(folder, bytes(15 << 20), 1000)


def ros1_images(kind, content, count):
    """A connection and messages."""
    of_type = struct.pack("<I", 5 + len(kind)) + b"type=" + kind
    out = [ros1({b"op": b"\7", b"conn": bytes(4), b"topic": b"/image/compressed"}, of_type)]
    for number in range(count):
        time = struct.pack("<II", number // 30, number % 30 * 33_000_000)
        out.append(ros1({b"op": b"\2", b"conn": bytes(4), b"time": time}, struct.pack("<I", number) + time + bytes(4) + content))
    return b"".join(out)


@bomb(*BAG)
def bag_of_plain_jpegs(folder):
    picture = jpeg(3500, 3500)
    content = text(b"jpeg") + text(picture)
    return bag(folder, ros1_images(b"sensor_msgs/CompressedImage", content, (15 << 20) // len(content)), 8)


@bomb(*BAG)
def bag_of_tiny_images(folder):
    content = struct.pack("<II", 8, 8) + text(b"mono8") + b"\0" + struct.pack("<I", 8) + text(bytes(64))
    return bag(folder, ros1_images(b"sensor_msgs/Image", content, 100_000), 8)


@bomb(*BAG)
def bag_of_messages_of_nothing(folder):
    return bag(folder, ros1_images(b"sensor_msgs/Image", b"", 120_000), 8)


def sqlite(rows, overflow):
    """Tables `topics` and `messages`; the cells of `messages` are all one, whose bytes lie in a chain of pages."""
    size = 4096

    def varint(value):
        out = [value & 127]
        value >>= 7
        while value:
            out.insert(0, value & 127 | 128)
            value >>= 7
        return bytes(out)

    def row(number, values):
        types, data = b"", b""
        for value in values:
            if isinstance(value, int):
                types += varint(6)
                data += struct.pack(">q", value)
            elif isinstance(value, str):
                types += varint(13 + 2 * len(value))
                data += value.encode()
            else:
                types += varint(12 + 2 * len(value))
                data += value
        payload = varint(len(types) + (2 if len(types) > 126 else 1)) + types + data
        return payload

    def leaf(cells, at, offset=0):
        page = bytearray(size)
        page[offset] = 13
        page[offset + 3 : offset + 5] = struct.pack(">H", at)
        end = size
        begin = []
        for cell in cells:
            end -= len(cell)
            page[end : end + len(cell)] = cell
            begin.append(end)
        for index in range(at):
            page[offset + 8 + 2 * index : offset + 10 + 2 * index] = struct.pack(">H", begin[index % len(begin)])
        return page

    def cell(number, payload, first_overflow=None):
        head = varint(len(payload)) + varint(number)
        usable = size
        most, least = usable - 35, (usable - 12) * 32 // 255 - 23
        if len(payload) <= most:
            return head + payload, b""
        fitting = least + (len(payload) - least) % (usable - 4)
        local = fitting if fitting <= most else least
        return head + payload[:local] + struct.pack(">I", first_overflow), payload[local:]

    master = [
        row(1, ["table", "topics", "topics", 2, "CREATE TABLE topics(id, name, type)"]),
        row(2, ["table", "messages", "messages", 3, "CREATE TABLE messages(id, topic_id, timestamp, data)"]),
    ]
    first = leaf([cell(n + 1, payload)[0] for n, payload in enumerate(master)], 2, 100)
    header = b"SQLite format 3\0" + struct.pack(">HBBBBBB", size, 1, 1, 0, 64, 32, 32)
    first[: len(header)] = header
    topics = leaf([cell(1, row(1, [1, "/image", "sensor_msgs/msg/Image", "cdr"]))[0]], 1)
    # so long that little of it lies in the leaf, beside the places of all cells
    for more in range(0, size, 32):
        body, rest = cell(1, row(1, [1, 1, 5, overflow + bytes(more)]), 4)
        if len(body) < 700:
            break
    messages = leaf([body], min(rows, (size - 8 - len(body)) // 2))
    pages = []
    while rest:
        part, rest = rest[: size - 4], rest[size - 4 :]
        following = 4 + len(pages) + 1 if rest else 0
        pages.append(struct.pack(">I", following) + part + bytes(size - 4 - len(part)))
    return bytes(first) + bytes(topics) + bytes(messages) + b"".join(pages)


@bomb(*BAG)
def db3_whose_rows_are_one(folder):
    path = folder / "a.db3"
    path.write_bytes(sqlite(1500, cdr_image(900, 900, bytes(900 * 900))))
    return path


def pages_above(children):
    """A page of SQLite that leads to these."""
    page, end = bytearray(4096), 4096
    page[0] = 5
    page[3:5] = struct.pack(">H", len(children) - 1)
    for index, child in enumerate(children[:-1]):
        cell = struct.pack(">I", child) + b"\x05"
        end -= len(cell)
        page[end : end + len(cell)] = cell
        page[12 + 2 * index : 14 + 2 * index] = struct.pack(">H", end)
    page[5:7] = struct.pack(">H", end)
    page[8:12] = struct.pack(">I", children[-1])
    return bytes(page)


@bomb(*BAG)
def db3_whose_pages_are_one(folder):
    # each of thirty pages leads 400 times to the next
    data = sqlite(1500, cdr_image(64, 64, bytes(4096)))
    pages = [data[at : at + 4096] for at in range(0, len(data), 4096)]
    leaf = len(pages) + 1
    pages.append(pages[2])
    following = [leaf + 1 + n for n in range(29)] + [leaf]
    pages[2] = pages_above([following[0]] * 400)
    pages += [pages_above([page] * 400) for page in following[1:]]
    path = folder / "a.db3"
    path.write_bytes(b"".join(pages))
    return path


@bomb(*BAG)
def db3_that_leads_to_itself(folder):
    data = bytearray(sqlite(1500, cdr_image(64, 64, bytes(4096))))
    data[8192:12_288] = pages_above([3] * 400)
    path = folder / "a.db3"
    path.write_bytes(data)
    return path


@bomb(*BAG)
def db3_of_zstd_messages(folder):
    width = height = 4000
    head = cdr_image(width, height)
    zeros = zstd_of_zeros(width * height)
    raw = struct.pack("<I", len(head) << 3)[:3] + head
    packed = b"\x28\xb5\x2f\xfd" + bytes([0b1100_0000, 7 << 3]) + struct.pack("<Q", len(head) + width * height) + raw + zeros[14:]
    path = folder / "a.db3"
    path.write_bytes(sqlite(1500, packed))
    return path


@bomb(*BAG)
def db3_that_is_zstd(folder):
    path = folder / "a.db3.zstd"
    data = sqlite(1500, cdr_image(900, 900, bytes(900 * 900)))
    # the file, then zeros
    out, at = b"", 0
    for at in range(0, len(data), 1 << 16):
        part = data[at : at + (1 << 16)]
        out += struct.pack("<I", len(part) << 3)[:3] + part
    zeros = zstd_of_zeros(1 << 30)[14:]
    path.write_bytes(b"\x28\xb5\x2f\xfd" + bytes([0b0000_0000, 7 << 3]) + out + zeros)
    return path


# videos


class Bits:
    def __init__(self):
        self.bits = []

    def u(self, value, length):
        if length:
            self.bits.append(format(value, f"0{int(length)}b"))

    def ue(self, value):
        length = (value + 1).bit_length()
        self.bits.append("0" * (length - 1) + format(value + 1, "b"))

    def unit(self, kind):
        bits = "".join(self.bits) + "1"
        bits += "0" * (-len(bits) % 8)
        data = int(bits, 2).to_bytes(len(bits) // 8, "big")
        out, zeros = bytearray([kind]), 0
        for byte in data:
            if zeros >= 2 and byte <= 3:
                out.append(3)
                zeros = 0
            out.append(byte)
            zeros = zeros + 1 if byte == 0 else 0
        return bytes(out)


def h264(columns, rows, references=1, start=0, colour="420"):
    """Parameter sets, a plain picture and a slice that repeats what came before, from a macroblock on, of so many macroblocks;
    colour: 420, 444, or 422 with 10 bits."""
    sps = Bits()
    profile, flags, chroma, bits = {"420": (66, 0xC0, 1, 8), "422": (122, 0, 2, 10), "444": (244, 0, 3, 8)}[colour]
    sps.u(profile, 8), sps.u(flags, 8), sps.u(51, 8)
    sps.ue(0)  # id
    if colour != "420":
        sps.ue(chroma), sps.u(0, chroma == 3), sps.ue(bits - 8), sps.ue(bits - 8), sps.u(0, 2)
    for value in (0, 2, references):  # bits of frame numbers, order of pictures by their number, references
        sps.ue(value)
    sps.u(0, 1)
    sps.ue(columns - 1), sps.ue(rows - 1)
    sps.u(1, 1), sps.u(1, 1), sps.u(0, 1), sps.u(0, 1)
    pps = Bits()
    pps.ue(0), pps.ue(0), pps.u(0, 2), pps.ue(0), pps.ue(0), pps.ue(0), pps.u(0, 3)
    pps.ue(0), pps.ue(0), pps.ue(0), pps.u(0, 3)
    first = Bits()
    first.ue(0), first.ue(7), first.ue(0), first.u(0, 4), first.ue(0), first.u(0, 2), first.ue(0)
    for _ in range(columns * rows):
        first.ue(3)  # one prediction, no residual
        if colour == "444":
            first.ue(0), first.u(7, 3)
        else:
            first.ue(0), first.ue(0), first.u(1, 1)
    def again(number):
        bits = Bits()
        bits.ue(start), bits.ue(5), bits.ue(0), bits.u(number % 16, 4), bits.u(0, 1), bits.u(0, 1), bits.u(0, 1), bits.ue(0)
        bits.ue(columns * rows - start)
        return bits.unit(0x41)

    return sps.unit(0x67), pps.unit(0x68), first.unit(0x65), again


def box(kind, *content):
    content = b"".join(content)
    return struct.pack(">I", 8 + len(content)) + kind + content


def gpmf(key, kind, size, data):
    return key + kind + struct.pack(">BH", size, len(data) // max(size, 1)) + data + bytes(-len(data) % 4)


def telemetry_track(packet_bytes, count, offset):
    """A track of so many packets, all of them the same one."""
    table = box(b"stbl",
        box(b"stsd", struct.pack(">II", 0, 1), box(b"gpmd", bytes(8))),
        box(b"stts", struct.pack(">IIII", 0, 1, count, 1)),
        box(b"stsc", struct.pack(">IIIII", 0, 1, 1, 1, 1)),
        box(b"stsz", struct.pack(">III", 0, packet_bytes, count)),
        box(b"stco", struct.pack(">II", 0, count), struct.pack(">I", offset) * count))
    media = box(b"mdia",
        box(b"mdhd", struct.pack(">IIIIIHH", 0, 0, 0, 30, count, 0x55C4, 0)),
        box(b"hdlr", struct.pack(">II", 0, 0), b"meta", bytes(12), b"\0"),
        box(b"minf", table))
    return box(b"trak", media)


def mp4(columns, rows, count, references=1, claims=None, group=1, picture=lambda number: number, start=0, shown=None, colour="420"):
    """Of so many slices, `group` of them in a sample, each of the picture that is named; the last `shown` samples alone are shown."""
    sps, pps, first, again = h264(columns, rows, references, start, colour)
    units = [struct.pack(">I", len(unit)) + unit for unit in [first] + [again(picture(n)) for n in range(1, count)]]
    samples = units[:1] + [b"".join(units[n : n + group]) for n in range(1, count, group)]
    data = b"".join(samples)
    ftyp = box(b"ftyp", b"isom\0\0\0\0isomavc1")
    width, height = columns * 16, rows * 16
    matrix = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
    avcc = box(b"avcC", bytes([1, 66, 0xC0, 51, 0xFF, 0xE1]), struct.pack(">H", len(sps)), sps, b"\1", struct.pack(">H", len(pps)), pps)
    entry = box(b"avc1", bytes(6) + struct.pack(">H", 1) + bytes(16) + struct.pack(">HH", width % 65536, height % 65536)
                + struct.pack(">II", 0x480000, 0x480000) + bytes(4) + struct.pack(">H", 1) + bytes(32) + struct.pack(">Hh", 24, -1), avcc)
    total = claims or len(samples)
    stsz = struct.pack(">III", 0, 0, len(samples)) + b"".join(struct.pack(">I", len(s)) for s in samples)
    if claims:
        stsz = struct.pack(">III", 0, 1, claims)
    table = box(b"stbl",
        box(b"stsd", struct.pack(">II", 0, 1), entry),
        box(b"stts", struct.pack(">IIII", 0, 1, total, 1)),
        box(b"stsc", struct.pack(">IIIII", 0, 1, 1, total, 1)),
        box(b"stsz", stsz),
        box(b"stco", struct.pack(">III", 0, 1, len(ftyp) + 8)))
    media = box(b"mdia",
        box(b"mdhd", struct.pack(">IIIIIHH", 0, 0, 0, 30, total % 2**32, 0x55C4, 0)),
        box(b"hdlr", struct.pack(">II", 0, 0), b"vide", bytes(12), b"\0"),
        box(b"minf", box(b"vmhd", struct.pack(">IQ", 1, 0)), box(b"dinf", box(b"dref", struct.pack(">II", 0, 1), box(b"url ", struct.pack(">I", 1)))), table))
    edits = box(b"edts", box(b"elst", struct.pack(">IIIiI", 0, 1, shown, total - shown, 65536))) if shown else b""
    track = box(b"trak", box(b"tkhd", struct.pack(">IIIIII", 7, 0, 0, 1, 0, total % 2**32), bytes(8), struct.pack(">HHHH", 0, 0, 0, 0), matrix,
                              struct.pack(">II", width << 16 & 0xFFFFFFFF, height << 16 & 0xFFFFFFFF)), edits, media)
    movie = box(b"moov", box(b"mvhd", struct.pack(">IIIII", 0, 0, 0, 30, total % 2**32), struct.pack(">IH", 0x10000, 0x100), bytes(10), matrix, bytes(24), struct.pack(">I", 2)), track)
    return ftyp + box(b"mdat", data) + movie


VIDEO = ["check IN --fov 60", "run IN --fov 60 --out OUT", "run IN --out OUT"]


@bomb(*VIDEO)
def mp4_that_stands_still(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 30_000))
    return path


@bomb(*VIDEO)
def mp4_that_refers_to_everything(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 30_000, references=30_000))
    return path


@bomb(*VIDEO)
def mp4_that_refers_to_much(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 60_000, references=5))
    return path


@bomb(*VIDEO)
def mp4_of_10_bits_that_refers_to_as_much_as_8_bits_may(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 60_000, references=5, colour="422"))
    return path


@bomb(*VIDEO)
def mp4_of_10_bits_that_refers_to_much(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(240, 135, 60_000, references=2, colour="422"))
    return path


@bomb(*VIDEO)
def mp4_of_larger_pictures(folder):
    # which ffmpeg decodes
    path = folder / "a.mp4"
    path.write_bytes(mp4(512, 256, 20_000))
    return path


@bomb(*VIDEO)
def mp4_of_larger_pictures_in_full_colour(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(512, 256, 20_000, colour="444"))
    return path


@bomb(*VIDEO)
def mp4_of_the_largest_pictures(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(900, 900, 2000))
    return path


@bomb(*VIDEO)
def mp4_of_larger_pictures_that_refers_to_much(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(512, 256, 20_000, references=16))
    return path


@bomb(*VIDEO)
def mp4_of_many_pictures_in_a_sample(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 30_000, group=1000))
    return path


@bomb(*VIDEO)
def mp4_of_slices_over_each_other(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 30_000, group=1000, picture=lambda number: (number - 1) // 1000 + 1, start=1))
    return path


@bomb(*VIDEO)
def mp4_of_slices_at_the_end_of_a_picture(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 60_000, group=1000, picture=lambda number: (number - 1) // 1000 + 1, start=36_000))
    return path


@bomb(*VIDEO)
def mp4_that_shows_its_end_alone(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(256, 144, 30_000, shown=30))
    return path


@bomb(*VIDEO)
def mp4_of_billions(folder):
    path = folder / "a.mp4"
    path.write_bytes(mp4(20, 15, 2, claims=2**32 - 1))
    return path


@bomb(*VIDEO)
def mp4_of_boxes_in_boxes(folder):
    path = folder / "a.mp4"
    content = b""
    for _ in range(3000):
        content = box(b"moov", content)
    path.write_bytes(box(b"ftyp", b"isom\0\0\0\0isomavc1") + content)
    return path


@bomb("check IN --fov 60", "run IN --fov 60 --max-frames 3 --out OUT")
def mp4_whose_telemetry_is_one_packet(folder):
    path = folder / "a.mp4"
    readings = [gpmf(key, b"s", 6, bytes(6 * 8000)) for key in (b"ACCL", b"GYRO")]
    streams = [gpmf(b"STRM", b"\0", 1, gpmf(b"SCAL", b"s", 2, b"\0\1") + gpmf(b"ORIN", b"c", 1, b"XYZ") + reading) for reading in readings]
    packet = box(b"free", gpmf(b"DEVC", b"\0", 1, streams[0]) + gpmf(b"DEVC", b"\0", 1, streams[1]))
    film = mp4(20, 15, 40)
    at = film.index(b"moov") - 4
    movie = film[at + 8 :] + telemetry_track(len(packet) - 8, 200_000, at + 8)
    path.write_bytes(film[:at] + packet + box(b"moov", movie))
    return path


@bomb(*VIDEO)
def mp4_of_many_tracks(folder):
    path = folder / "a.mp4"
    path.write_bytes(box(b"ftyp", b"isom\0\0\0\0isomavc1") + box(b"moov", box(b"mvhd", bytes(100)), box(b"trak") * 120_000))
    return path


@bomb(*VIDEO)
def gif_of_large_pictures(folder):
    side = 5700
    path = folder / "a.gif"
    picture = lzw_zeros(side * side)
    frame = b"," + struct.pack("<HHHHB", 0, 0, side, side, 0) + b"\x08" + picture
    head = b"GIF89a" + struct.pack("<HHBBB", side, side, 0xF7, 0, 0) + bytes(768)
    path.write_bytes(head + (b"!\xf9\x04\0\x03\0\0\0" + frame) * (900_000 // len(frame)) + b";")
    return path


def lzw_zeros(count):
    """So many zeros as blocks of GIF: each code stands for one more than the one before it."""
    value, length, out = 0, 0, bytearray()

    def put(code, width):
        nonlocal value, length
        value |= code << length
        length += width
        while length >= 8:
            out.append(value & 255)
            value >>= 8
            length -= 8

    put(256, 9)
    left = count
    while left > 0:
        width, following, run = 9, 258, 1
        put(0, width)
        left -= 1
        # each code is new: the one before it and a zero more
        while left > 0 and following < 4094:
            run = min(run + 1, left)
            put(following if run > 1 else 0, width)
            following += 1
            if following == 1 << width and width < 12:
                width += 1
            left -= run
        if left > 0:
            put(256, width)
    put(257, 12)
    put(0, 8)
    return b"".join(bytes([len(out[at : at + 255])]) + out[at : at + 255] for at in range(0, len(out), 255)) + b"\0"


@bomb(*VIDEO)
def apng_of_large_pictures(folder):
    side = 5700
    picture = zlib.compress(bytes((side + 1) * side), 9)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0))
    count = 900_000 // len(picture)
    control = lambda n: chunk(b"fcTL", struct.pack(">IIIIIHHBB", n, side, side, 0, 0, 1, 30, 0, 0))
    frames = control(0) + chunk(b"IDAT", picture)
    for n in range(1, count):
        frames += control(2 * n - 1) + chunk(b"fdAT", struct.pack(">I", 2 * n) + picture)
    path = folder / "a.apng"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"acTL", struct.pack(">II", count, 0)) + frames + chunk(b"IEND", b""))
    return path


@bomb(*VIDEO)
def y4m_of_years(folder):
    path = folder / "a.y4m"
    path.write_bytes(b"YUV4MPEG2 W64 H64 F1:400000000 Cmono\n" + (b"FRAME\n" + bytes(64 * 64)) * 200)
    return path


@bomb(*VIDEO)
def y4m_of_a_huge_header(folder):
    path = folder / "a.y4m"
    path.write_bytes(b"YUV4MPEG2 W8000 H8000 F30:1 Cmono\nFRAME\n" + bytes(900_000))
    return path


@bomb(*VIDEO)
def y4m_of_tiny_frames(folder):
    path = folder / "a.y4m"
    path.write_bytes(b"YUV4MPEG2 W8 H8 F30:1 Cmono\n" + (b"FRAME\n" + bytes(64)) * 14_000)
    return path


@bomb(*VIDEO)
def y4m_of_thin_pixels(folder):
    path = folder / "a.y4m"
    path.write_bytes(b"YUV4MPEG2 W64 H64 F30:1 A1:4000000000 Cmono\n" + (b"FRAME\n" + bytes(64 * 64)) * 200)
    return path


@bomb(*VIDEO)
def avi_of_plain_images(folder):
    picture = jpeg(3500, 3500)
    picture += b"\0" * (len(picture) % 2)
    strh = b"vidsMJPG" + struct.pack("<IHHIIIIIIIIHHHH", 0, 0, 0, 0, 1, 30, 0, 18, 0, 0, 0, 0, 0, 0, 0)
    strf = struct.pack("<IiiHH4sIiiII", 40, 3500, 3500, 1, 24, b"MJPG", 0, 0, 0, 0, 0)
    part = lambda kind, data: kind + struct.pack("<I", len(data)) + data
    header = part(b"LIST", b"hdrl" + part(b"avih", bytes(56)) + part(b"LIST", b"strl" + part(b"strh", strh) + part(b"strf", strf)))
    movie = part(b"LIST", b"movi" + part(b"00dc", picture) * (900_000 // len(picture)))
    path = folder / "a.avi"
    path.write_bytes(part(b"RIFF", b"AVI " + header + movie))
    return path


# lists, calibrations and the like


def trajectory(folder, content):
    path = folder / "t.txt"
    path.write_text(content)
    return path


TRAJECTORIES = ["evaluate trajectory IN IN", "evaluate trajectory IN IN --json", "truth office --trajectory IN --out OUT.ot", "map DIR --trajectory IN --out OUT.ot",
                "synth office --trajectory IN --size 32x32 --max-frames 2 --out OUT"]


@bomb(*TRAJECTORIES)
def trajectory_of_one_line(folder):
    return trajectory(folder, "1 " * 500_000)


@bomb(*TRAJECTORIES)
def trajectory_of_many_poses(folder):
    return trajectory(folder, "".join(f"{n} {n % 7} 0 0 0 0 0 1\n" for n in range(44_000)))


@bomb(*TRAJECTORIES)
def trajectory_that_never_moves(folder):
    return trajectory(folder, "".join(f"{n} 0 0 0 0 0 0 1\n" for n in range(48_000)))


@bomb(*TRAJECTORIES)
def trajectory_to_the_end_of_numbers(folder):
    return trajectory(folder, "".join(f"{n * 1e8:.0f} {n}e300 0 {n}e-300 0 0 0 1\n" for n in range(20_000)))


@bomb("check DIR --imu IN --fov 60")
def imu_of_many_readings(folder):
    images(folder, png(64, 64), "png", 3)
    path = folder / "imu.csv"
    path.write_text("".join(f"{n},0,0,0,0,0,9\n" for n in range(50_000)))
    return path


@bomb("run DIR/images --imu IN --imu-from-camera DIR/mount.txt --fov 60 --out OUT", "check DIR/images --imu IN --fov 60")
def imu_of_years(folder):
    images(folder, png(320, 240), "png", 40)
    (folder / "mount.txt").write_text("0 0 0 0 0 0 1\n")
    path = folder / "imu.csv"
    path.write_text("".join(f"{n * n * 10**13},0.1,0,0,0,0,9\n" for n in range(300)))
    return path


def masks(folder, picture, count):
    images(folder, png(64, 64), "png", 500)
    masks = folder / "masks"
    masks.mkdir()
    for index in range(count):
        (masks / f"{index:04}.png").write_bytes(picture)
    return masks


MASKS = ["check DIR/images --mask IN --fov 60", "run DIR/images --mask IN --fov 60 --out OUT"]


@bomb(*MASKS)
def masks_of_plain(folder):
    return masks(folder, png(3500, 3500), 40)


@bomb(*MASKS)
def mask_of_plain(folder):
    return masks(folder, png(3500, 3500), 1) / "0000.png"


@bomb(*MASKS)
def masks_in_a_video_that_stands_still(folder):
    masks(folder, png(64, 64), 1)
    path = folder / "masks.mp4"
    path.write_bytes(mp4(144, 144, 30_000))
    return path


@bomb("check DIR/images --mask IN --fov 60")
def mask_of_large_images(folder):
    images(folder, png(3500, 3500), "png", 5)
    path = folder / "mask.png"
    path.write_bytes(rows_png([bytes(row) for row in ([0, 255] * 1750, [255, 0] * 1750)] * 1750, 3500))
    return path


CALIBRATIONS = ["check DIR/images --calibration IN"]


def calibration(folder, name, content):
    images(folder, png(64, 64), "png", 3)
    path = folder / name
    path.write_text(content)
    return path


@bomb(*CALIBRATIONS)
def yaml_in_itself(folder):
    return calibration(folder, "c.yaml", "".join(" " * n + f"k{n}:\n" for n in range(1350)))


@bomb(*CALIBRATIONS)
def yaml_of_brackets(folder):
    return calibration(folder, "c.yaml", "cam0:\n  intrinsics: " + "[" * 900_000)


@bomb(*CALIBRATIONS)
def yaml_of_braces(folder):
    return calibration(folder, "c.yaml", "cam0: " + "{a: " * 200_000)


@bomb(*CALIBRATIONS)
def yaml_of_aliases(folder):
    lines = ["a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    lines += [f"a{n}: &a{n} [" + ", ".join([f"*a{n - 1}"] * 9) + "]" for n in range(1, 30)]
    return calibration(folder, "c.yaml", "\n".join(lines) + "\nintrinsics: *a29\n")


@bomb(*CALIBRATIONS)
def yaml_of_dashes(folder):
    return calibration(folder, "c.yaml", "cam0:\n" + "  - " * 200_000 + "\n" + "  - 1\n" * 10_000)


@bomb(*CALIBRATIONS)
def yaml_of_long_keys(folder):
    return calibration(folder, "c.yaml", "k" * 900_000 + ":\n  a: 1\n")


@bomb(*CALIBRATIONS)
def xml_in_itself(folder):
    return calibration(folder, "c.xml", "<?xml version=\"1.0\"?><opencv_storage>" + "<a>" * 300_000)


@bomb(*CALIBRATIONS)
def json_in_itself(folder):
    return calibration(folder, "c.json", '{"a":' * 150_000)


@bomb(*CALIBRATIONS)
def toml_in_itself(folder):
    return calibration(folder, "c.toml", "a = " + "[" * 900_000)


@bomb(*CALIBRATIONS)
def toml_of_tables(folder):
    return calibration(folder, "c.toml", "".join(f"[{'a.' * 400}b{n}]\n" for n in range(1000)))


@bomb("run DIR/images --config IN --fov 60 --out OUT")
def config_in_itself(folder):
    return calibration(folder, "c.toml", "slam = " + "{a=" * 200_000)


@bomb("batch IN --out OUT", "report IN")
def batch_of_one_line(folder):
    path = folder / "a.tsv"
    path.write_text("nothing" + "\tname=a" * 140_000 + "\n")
    return path


# meshes and clouds

MESHES = ["truth IN --trajectory DIR/path.txt --out OUT.ot", "truth IN --trajectory DIR/path.txt --resolution 0.01 --out OUT.ot",
          "view IN --html OUT.html", "view IN --png OUT.png", "synth IN --trajectory DIR/path.txt --frames 2 --size 64x48 --out OUT"]


def mesh(folder, name, data):
    (folder / "path.txt").write_text("".join(f"{n} {n} 1 1 0 0 0 1\n" for n in range(1, 9)))
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


@bomb(*MESHES)
def obj_of_large_triangles(folder):
    faces = "".join(f"f {1 + n % 3} {1 + (n + 1) % 3} {1 + (n + 2) % 3}\n" for n in range(80_000))
    return mesh(folder, "a.obj", "v 0 0 0\nv 30 0 0\nv 0 30 30\n" + faces)


@bomb(*MESHES)
def obj_of_a_long_wall(folder):
    return mesh(folder, "a.obj", "v 0 0 0\nv 1600 0 0\nv 0 1600 1600\nv 1600 1600 0\nf 1 2 3\nf 2 3 4\n")


@bomb(*MESHES)
def obj_of_many_large_triangles(folder):
    corners = "".join(f"v {n * 7 % 31} {n * 11 % 29} {n * 13 % 23}\n" for n in range(1000))
    faces = "".join(f"f {1 + n * 7 % 1000} {1 + n * 97 % 1000} {1 + n * 331 % 1000}\n" for n in range(1, 60_000))
    return mesh(folder, "a.obj", corners + faces)


@bomb(*MESHES)
def obj_of_far_points(folder):
    return mesh(folder, "a.obj", "".join(f"v {n}e5 {n % 7}e5 {n % 11}e5\n" for n in range(1, 30_000)) + "f 1 2 3\nf 100 200 300\n")


@bomb(*MESHES)
def ply_of_billions(folder):
    return mesh(folder, "a.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
                    "property float z\nelement face 4000000000\nproperty list uint int vertex_indices\nend_header\n" + "a" * 900_000)


@bomb(*MESHES)
def ply_of_empty_faces(folder):
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += b"element face 900000\nproperty list uchar uchar vertex_indices\nend_header\n"
    return mesh(folder, "a.ply", head + struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + bytes(900_000))


@bomb(*MESHES)
def ply_of_rows_of_nothing(folder):
    head = "ply\nformat ascii 1.0\nelement nothing 4000000000\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    return mesh(folder, "a.ply", head.replace("ascii", "binary_little_endian") + "end_header\n" + "a" * 36)


@bomb(*MESHES)
def ply_of_lists_of_nothing(folder):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "".join(f"property list uchar double a{n}\n" for n in range(19_000))
    return mesh(folder, "a.ply", head.encode() + b"end_header\n" + bytes(400_000))


@bomb(*MESHES)
def obj_of_one_polygon(folder):
    corners = "".join(f"v {n % 300} {n * 7 % 293} {n * 11 % 17}\n" for n in range(20_000))
    return mesh(folder, "a.obj", corners + "f " + " ".join(str(n) for n in range(1, 20_001)) + "\n")


@bomb(*MESHES)
def pcd_that_is_packed(folder):
    head = b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 300000000\nHEIGHT 1\nPOINTS 300000000\nDATA binary_compressed\n"
    # LZF: 264 bytes of what was before in three
    return mesh(folder, "a.pcd", head + struct.pack("<II", 900_000, 3_600_000_000) + b"\0\0" + b"\xe0\xff\0" * 299_999)


@bomb(*MESHES)
def ply_of_long_lists(folder):
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += b"element face 2\nproperty list uint uchar vertex_indices\nend_header\n"
    return mesh(folder, "a.ply", head + struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + struct.pack("<I", 2**32 - 1) + bytes(900_000))


# no truth is made of it
SHOWN = MESHES[2:4]


def glb(folder, json, binary):
    text = json.encode() + b" " * (-len(json) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return mesh(folder, "a.glb", b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)


def glb_of(parts, nodes, accessors, lengths, more=""):
    views, start = [], 0
    for length in lengths:
        views.append('{"byteOffset":%d,"byteLength":%d}' % (start, length))
        start += length
    return '{"scenes":[{"nodes":[%s]}],"nodes":[%s],"meshes":[{"primitives":[%s]}],"accessors":[%s],"bufferViews":[%s]%s}' % (
        ",".join(str(n) for n in range(nodes)), ",".join(['{"mesh":0}'] * nodes), ",".join(parts), ",".join(accessors), ",".join(views), more)


def accessor(view, kind, count, shape):
    return '{"bufferView":%d,"componentType":%d,"count":%d,"type":"%s"}' % (view, kind, count, shape)


CORNERS = struct.pack("<9f", 0, 0, 0, 20, 0, 0, 0, 20, 5)


@bomb(*SHOWN)
def glb_of_the_same_corners(folder):
    parts = ['{"attributes":{"POSITION":0},"indices":1}'] * 4000
    accessors = [accessor(0, 5126, 3, "VEC3"), accessor(1, 5121, 600_000, "SCALAR")]
    return glb(folder, glb_of(parts, 4000, accessors, [36, 600_000]), CORNERS + b"\0\1\2" * 200_000)


@bomb(*SHOWN)
def glb_of_the_same_colours(folder):
    parts = ['{"attributes":{"POSITION":0,"COLOR_0":1}}'] * 4000
    accessors = [accessor(0, 5126, 3, "VEC3"), accessor(1, 5121, 150_000, "VEC4")]
    return glb(folder, glb_of(parts, 4000, accessors, [36, 600_000]), CORNERS + bytes(600_000))


@bomb(*SHOWN)
def glb_of_the_same_places(folder):
    parts = ['{"attributes":{"POSITION":0}}'] * 30
    corners = b"".join(struct.pack("<3f", n * 7 % 31, n * 11 % 29, n * 13 % 23) for n in range(30_000))
    return glb(folder, glb_of(parts, 4000, [accessor(0, 5126, 30_000, "VEC3")], [len(corners)]), corners)


@bomb(*SHOWN)
def glb_of_numbers_within_each_other(folder):
    # a stride of one byte for values of twelve is not allowed; a number of one byte is a corner
    parts = ['{"attributes":{"POSITION":0},"indices":1}']
    accessors = [accessor(0, 5121, 300_000, "VEC3"), accessor(1, 5121, 990_000, "SCALAR")]
    return glb(folder, glb_of(parts, 1, accessors, [990_000]).replace('"bufferView":1', '"bufferView":0'), bytes(n % 251 for n in range(990_000)))


@bomb(*SHOWN)
def glb_of_a_chain(folder):
    nodes = ",".join('{"children":[%d],"translation":[1e30,1e30,0]}' % (n + 1) for n in range(18_000))
    return glb(folder, '{"scenes":[{"nodes":[0]}],"nodes":[%s]}' % nodes, b"")


@bomb(*SHOWN)
def glb_in_itself(folder):
    return glb(folder, '{"nodes":' + "[" * 900_000, b"")


@bomb(*SHOWN)
def glb_of_large_pictures(folder):
    picture = jpeg(4000, 4000)
    count = 30
    parts = ['{"attributes":{"POSITION":0,"TEXCOORD_0":1},"material":0}'] * count
    accessors = [accessor(0, 5126, 3, "VEC3"), accessor(0, 5126, 3, "VEC2")]
    more = ',"materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],"textures":[{"source":0}],"images":[{"bufferView":1}]'
    return glb(folder, glb_of(parts, 1, accessors, [36, len(picture)], more), CORNERS + picture)


@bomb(*SHOWN)
def glb_far_away(folder):
    parts = ['{"attributes":{"POSITION":0}}']
    corners = b"".join(struct.pack("<3f", n * 7 % 31 * 1e36, n * 11 % 29 * 1e36, n * 13 % 23 * 1e36) for n in range(30_000))
    return glb(folder, glb_of(parts, 1, [accessor(0, 5126, 30_000, "VEC3")], [len(corners)]), corners)


@bomb(*MESHES)
def pcd_of_billions(folder):
    return mesh(folder, "a.pcd", "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4000000000\nHEIGHT 1\nPOINTS 4000000000\n"
                    "DATA binary\n" + "a" * 900_000)


@bomb(*MESHES)
def pcd_of_far_points(folder):
    rows = "".join(f"{n % 97}e4 {n % 89}e4 {n % 83}e4\n" for n in range(60_000))
    return mesh(folder, "a.pcd", "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60000\nHEIGHT 1\nPOINTS 60000\nDATA ascii\n" + rows)


@bomb("map IN --out OUT.ot", "map IN --out OUT.ot --integration rays", "map IN --out OUT.ot --resolution 0.001")
def scans_of_far_points(folder):
    points = b"".join(struct.pack("<4f", 1e3 * (n % 50 - 25), 1e3 * (n % 41 - 20), 1e3 * (n % 31), 0.01) for n in range(50_000))
    return mesh(folder, "a.scans", struct.pack("<II", 0x4F474D31, 1) + struct.pack("<12d", 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0) + struct.pack("<I", 50_000) + points)


@bomb("map IN --out OUT.ot", "run IN --fov 60 --out OUT", "truth IN --out OUT.ot", "truth IN --every 1 --resolution 0.01 --out OUT.ot")
def depth_images_of_plain(folder, lens=""):
    depth = folder / "set" / "depth"
    depth.mkdir(parents=True)
    for index in range(30):
        (depth / f"{index}.png").write_bytes(png(3500, 3500, 16))
    (depth.parent / "depth.txt").write_text("".join(f"{n} depth/{n % 30}.png\n" for n in range(3000)))
    (depth.parent / "groundtruth.txt").write_text("".join(f"{n} 0 0 {n} 0 0 0 1\n" for n in range(3000)))
    (depth.parent / "calibration_depth.txt").write_text(f"3000 3000 1750 1750 {lens} 3500 3500\n5000\n")
    return depth.parent


@bomb("map IN --out OUT.ot", "truth IN --out OUT.ot")
def depth_images_of_a_lens(folder):
    return depth_images_of_plain(folder, "0.1 -0.05 0.001 0.001 0.01")


@bomb("map IN --out OUT.ot", "truth IN --out OUT.ot")
def depth_of_an_endless_camera(folder):
    path = depth_images_of_plain(folder)
    (path / "calibration_depth.txt").write_text("3000 3000 1750 1750 1000000000 1000000000\n5000\n")
    return path


def limit():
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_SECONDS_MEASURED, MAX_SECONDS_MEASURED))


def with_children(process):
    """A process and those that it started, and they."""
    yield process
    for children in Path("/proc", str(process), "task").glob("*/children"):
        for child in children.read_text().split():
            yield from with_children(child)


def resident_kb(process):
    """Memory that a process and those that it started have now."""
    pages = 0
    try:
        for one in with_children(process):
            # what is of files is shared, and the system may take it back
            _, resident, shared, *_ = Path("/proc", str(one), "statm").read_text().split()
            pages += int(resident) - int(shared)
    except OSError:
        pass  # one of them has ended
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


def measured(program, words, folder):
    """Exit code, seconds of the processor and of the clock, kilobytes, what was said."""
    said = folder / "said"
    begin = time.monotonic()
    most_kb = 0
    with said.open("wb") as out:
        child = subprocess.Popen([program, *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=out, cwd=folder,
                                 preexec_fn=limit, start_new_session=True)
    while True:
        pid, status, usage = os.wait4(child.pid, os.WNOHANG)
        if pid:
            break
        if time.monotonic() - begin > PATIENCE_SECONDS:
            os.killpg(child.pid, signal.SIGKILL)
            _, status, usage = os.wait4(child.pid, 0)
            break
        most_kb = max(most_kb, resident_kb(child.pid))
        time.sleep(0.02)
    child.returncode = os.waitstatus_to_exitcode(status)
    seconds = usage.ru_utime + usage.ru_stime
    # the most of the program alone is known exactly, that of all together as often as it was looked at
    return child.returncode, seconds, time.monotonic() - begin, max(usage.ru_maxrss, most_kb), said.read_text(errors="replace")


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program, words = os.path.abspath(sys.argv[1]), sys.argv[2:]
    harmed = 0
    for name, (make, commands) in BOMBS.items():
        if words and not any(word in name for word in words):
            continue
        with tempfile.TemporaryDirectory(prefix="bombs-") as scratch:
            folder = Path(os.environ["KEEP"], name) if os.environ.get("KEEP") else Path(scratch)
            folder.mkdir(parents=True, exist_ok=bool(not os.environ.get("KEEP")))
            path = make(folder)
            files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
            size = sum(file.stat().st_size for file in files)
            for index, command in enumerate(commands):
                for_words = {"IN": str(path), "DIR": str(folder)}
                arguments = [word.replace("OUT", f"{scratch}/out{index}") for word in command]
                arguments = [for_words.get(word, word.replace("DIR/", f"{folder}/")) for word in arguments]
                code, seconds, clock, memory, said = measured(program, arguments, folder)
                is_harm = seconds > MAX_SECONDS or memory > MAX_MEMORY_KB or not 0 <= code <= 4 or "panicked" in said
                harmed += is_harm
                last = said.strip().splitlines()[-1:] or [""]
                print(f"{'HARM' if is_harm else 'ok  '} {name:34} {size / 1e3:6.0f} kB  {seconds:6.1f} s ({clock:5.1f})  "
                      f"{memory / 1e3:6.0f} MB  code {code:4}  {' '.join(command)[:60]:60} {last[0][:150]}", flush=True)
    print(f"{harmed} did harm")
    sys.exit(harmed > 0)


if __name__ == "__main__":
    main()
