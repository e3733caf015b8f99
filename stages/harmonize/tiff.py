"""TIFF frames in memory: pixels out, and resampled pixels back in with every tag that does not describe them.

The reader takes strips and tiles, chunky and planar, 8/16-bit whole numbers
and 32/64-bit floats, stored plain, deflated, LZW or PackBits. The writer makes
one chunky picture in strips, plain where the original was plain, else deflated.
Reference: TIFF 6.0; Adobe Photoshop TIFF technical notes (Deflate); Adobe
technical note 3 (floating-point predictor).
"""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass
from typing import Dict, List, Optional, Tuple

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..thresholds import Thresholds
from .exif import EXIF_IFD, GPS_IFD, INTEROP_IFD, TYPE_BYTES, Entry, TagEdit, TiffBlock, damaged, edit_tags

Pixels = npt.NDArray[np.generic]

_PLAIN, _LZW, _PACKBITS = 1, 5, 32773
_DEFLATE = (8, 32946)
_BITS, _COMPRESSION, _PHOTOMETRIC = 258, 259, 262
_STRIPS, _SAMPLES, _ROWS, _STRIP_BYTES, _PLANAR = 273, 277, 278, 279, 284
_PREDICTOR, _TILE_WIDTH, _TILE_LENGTH, _TILES, _TILE_BYTES = 317, 322, 323, 324, 325
_FORMAT = 339
_YCBCR, _PALETTE = 6, 3
_MAKER_NOTE, _UNDEFINED = 0x927C, 7
# What describes the old pixels, their storage, other pages, or their place on a map.
_STORAGE = {256, 257, _BITS, _COMPRESSION, 266, _STRIPS, _SAMPLES, _ROWS, _STRIP_BYTES, _PLANAR, _PREDICTOR, 288, 289}
_TILING = {_TILE_WIDTH, _TILE_LENGTH, _TILES, _TILE_BYTES}
_OLD_JPEG = {347, 512, 513, 514, 515, 517, 518, 519, 520, 521}
_SUB_PAGES, _ON_A_MAP = {330}, {33550, 33922, 34264}
_LEFT_BEHIND = frozenset(_STORAGE | _TILING | _OLD_JPEG | _SUB_PAGES | _ON_A_MAP)
_STRIP_TARGET_BYTES = 256 * 1024


@dataclass(frozen=True)
class Layout:
    """How a TIFF's first picture is stored. ``dtype`` carries the file's byte order."""

    width: int
    height: int
    channels: int
    dtype: "np.dtype[np.generic]"
    compression: int
    predictor: int
    planar: bool
    block: Tuple[int, int]
    tiled: bool
    offsets: Tuple[int, ...]
    lengths: Tuple[int, ...]


def _unsupported(detail: str) -> FrameError:
    return FrameError("pixels-not-supported", f"The pixels of this TIFF cannot be resampled: {detail}.")


def layout(block: TiffBlock) -> Layout:
    """Read how the first picture is stored; ``FrameError`` where that is unsupported or makes no sense."""
    found = {e.tag: e for e in block.entries(block.first)[0]}

    def numbers(tag: int, default: Optional[int] = None) -> Tuple[int, ...]:
        if tag not in found:
            if default is None:
                raise _unsupported(f"tag {tag} is missing")
            return (default,)
        return _whole_numbers(block, found[tag])

    width, height = numbers(256)[0], numbers(257)[0]
    channels = numbers(_SAMPLES, 1)[0]
    bits = numbers(_BITS, 1)
    kind = numbers(_FORMAT, 1)[0]
    if not (0 < width <= 0xFFFF and 0 < height <= 0xFFFF and 0 < channels <= 32):
        raise _unsupported("its size makes no sense")
    if len(set(bits)) > 1 or numbers(266, 1)[0] != 1 or numbers(_PHOTOMETRIC, 1)[0] in (_YCBCR, _PALETTE):
        raise _unsupported("palette, subsampled or mixed-depth pixels")
    code = {(8, 1): "u1", (16, 1): "u2", (8, 2): "i1", (16, 2): "i2", (32, 3): "f4", (64, 3): "f8"}.get((bits[0], kind))
    if code is None:
        raise _unsupported(f"{bits[0]} bits of sample format {kind}")
    compression = numbers(_COMPRESSION, 1)[0]
    predictor = numbers(_PREDICTOR, 1)[0]
    if compression not in (_PLAIN, _LZW, _PACKBITS, *_DEFLATE) or predictor not in (1, 2, 3):
        raise _unsupported(f"compression {compression}")
    tiled = _TILES in found
    if tiled:
        size = (numbers(_TILE_LENGTH)[0], numbers(_TILE_WIDTH)[0])
    else:
        size = (min(numbers(_ROWS, height)[0], height), width)
    if not (0 < size[0] <= 0xFFFF and 0 < size[1] <= 0xFFFF):
        raise _unsupported("its strips make no sense")
    offsets = numbers(_TILES if tiled else _STRIPS)
    lengths = numbers(_TILE_BYTES if tiled else _STRIP_BYTES)
    planar = channels > 1 and numbers(_PLANAR, 1)[0] == 2
    needed = -(-height // size[0]) * -(-width // size[1]) * (channels if planar else 1)
    if len(offsets) < needed or len(lengths) < needed:
        raise _unsupported("strips are missing")
    dtype = np.dtype(block.order + code)
    return Layout(width, height, channels, dtype, compression, predictor, planar, size, tiled, offsets, lengths)


def _whole_numbers(block: TiffBlock, entry: Entry) -> Tuple[int, ...]:
    code = {1: "B", 3: "H", 4: "I"}.get(entry.kind)
    if code is None or not entry.count:
        raise _unsupported(f"tag {entry.tag} makes no sense")
    return struct.unpack_from(f"{block.order}{entry.count}{code}", block.data, entry.value_at)


def decode(data: bytes, limits: Thresholds) -> Pixels:
    """Decode the first picture as (height, width, channels), native byte order.

    ``FrameError`` ``pixels-not-supported``, ``frame-too-large`` or
    ``pixels-broken`` (a strip is cut or does not unpack).
    """
    block = TiffBlock(bytearray(data))
    plan = layout(block)
    if plan.width * plan.height > limits.max_input_megapixels * 1e6:
        raise FrameError("frame-too-large", f"{plan.width}x{plan.height} pixels are more than can be worked on.")
    rows, columns = plan.block
    down, across = -(-plan.height // rows), -(-plan.width // columns)
    deep = 1 if plan.planar else plan.channels
    if rows * columns * deep > 2 * limits.max_input_megapixels * 1e6:
        raise _unsupported("its tiles are larger than any picture")
    pixels = np.empty((plan.height, plan.width, plan.channels), plan.dtype.newbyteorder("="))
    for index in range(down * across * (plan.channels if plan.planar else 1)):
        plane, place = divmod(index, down * across)
        top, left = (place // across) * rows, (place % across) * columns
        tall = rows if plan.tiled else min(rows, plan.height - top)
        raw = data[plan.offsets[index] : plan.offsets[index] + plan.lengths[index]]
        part = _unpack(raw, plan, (tall, columns, deep))
        target = pixels[top : top + tall, left : left + columns]
        cut = part[: target.shape[0], : target.shape[1]]
        if plan.planar:
            target[:, :, plane] = cut[:, :, 0]
        else:
            target[...] = cut
    return pixels


def _unpack(raw: bytes, plan: Layout, shape: Tuple[int, int, int]) -> Pixels:
    row_bytes = shape[1] * shape[2] * plan.dtype.itemsize
    wanted = shape[0] * row_bytes
    if plan.compression in _DEFLATE:
        try:
            raw = zlib.decompressobj().decompress(raw, wanted)
        except zlib.error:
            raise FrameError("pixels-broken", "A strip of this TIFF does not unpack.") from None
    elif plan.compression in (_LZW, _PACKBITS):
        raw = _unpack_bytes(raw, plan.compression, row_bytes, shape[0])
    if len(raw) < wanted:
        raise FrameError("pixels-broken", "A strip of this TIFF is cut: the file was not copied whole.")
    if plan.predictor == 3 and plan.compression != _PLAIN:
        return _undo_float_predictor(raw[:wanted], plan, shape)
    part = (
        np.frombuffer(raw, plan.dtype, wanted // plan.dtype.itemsize)
        .reshape(shape)
        .astype(plan.dtype.newbyteorder("="))
    )
    if plan.predictor == 2 and plan.compression != _PLAIN:
        if plan.dtype.kind == "f":
            raise _unsupported("floats with a whole-number predictor")
        part = np.cumsum(part, axis=1, dtype=part.dtype)
    return part


def _unpack_bytes(raw: bytes, compression: int, row_bytes: int, rows: int) -> bytes:
    """Unpack LZW or PackBits by reading the strip as a grey 8-bit picture of its own."""
    from PIL import Image

    tags: Tuple[Tuple[int, int], ...] = (
        (256, row_bytes),
        (257, rows),
        (_BITS, 8),
        (_COMPRESSION, compression),
        (_PHOTOMETRIC, 1),
    )
    tags += ((_STRIPS, 8 + 2 + 12 * 9 + 4), (_SAMPLES, 1), (_ROWS, rows), (_STRIP_BYTES, len(raw)))
    head = b"II*\x00" + struct.pack("<IH", 8, len(tags))
    head += b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags) + b"\x00" * 4
    try:
        with Image.open(io.BytesIO(head + raw), formats=("TIFF",)) as picture:
            return bytes(picture.tobytes())
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise FrameError("pixels-broken", "A strip of this TIFF does not unpack.") from None


def _undo_float_predictor(raw: bytes, plan: Layout, shape: Tuple[int, int, int]) -> Pixels:
    size = plan.dtype.itemsize
    rows = np.frombuffer(raw, np.uint8).reshape(shape[0], size * shape[1], shape[2])
    planes = np.cumsum(rows, axis=1, dtype=np.uint8).reshape(shape[0], size, shape[1] * shape[2])
    joined = np.ascontiguousarray(planes.transpose(0, 2, 1)).view(np.dtype(f">f{size}"))
    return joined.reshape(shape).astype(plan.dtype.newbyteorder("="))


def encode(original: bytes, pixels: Pixels, edit: TagEdit) -> bytes:
    """Write ``pixels`` (height, width, channels) with the tags of ``original`` and ``edit`` carried out.

    Kept with type and bytes: XMP (700), Exif, GPS and Interop directories,
    black level, Make to Copyright, unknown tags. A maker note keeps its offset
    where it stood in the first megabyte, because its own offsets may count
    from the file's start.
    """
    source = TiffBlock(bytearray(original))
    old = layout(source)
    height, width, channels = pixels.shape
    body = np.ascontiguousarray(pixels, old.dtype)
    row_bytes = width * channels * old.dtype.itemsize
    rows = min(height, max(1, _STRIP_TARGET_BYTES // row_bytes))
    strips = [body[top : top + rows].tobytes() for top in range(0, height, rows)]
    compression = old.compression if old.compression == _PLAIN else _DEFLATE[0]
    if compression != _PLAIN:
        strips = [zlib.compress(s, 6) for s in strips]
    order = source.order
    storage: Dict[int, Tuple[int, bytes]] = {
        256: (4, struct.pack(order + "I", width)),
        257: (4, struct.pack(order + "I", height)),
        _BITS: (3, struct.pack(f"{order}{channels}H", *[8 * old.dtype.itemsize] * channels)),
        _COMPRESSION: (3, struct.pack(order + "H", compression)),
        _STRIPS: (4, b"\x00" * 4 * len(strips)),
        _SAMPLES: (3, struct.pack(order + "H", channels)),
        _ROWS: (4, struct.pack(order + "I", rows)),
        _STRIP_BYTES: (4, struct.pack(f"{order}{len(strips)}I", *(len(s) for s in strips))),
        _PLANAR: (3, struct.pack(order + "H", 1)),
    }
    writer = _Writer(source)
    writer.directory(source.first, storage)
    edit_tags(writer.block, edit)
    out = writer.block.data
    out.extend(b"\x00" * (-len(out) % 16))
    starts, at = [], len(out)
    for strip in strips:
        starts.append(at)
        at += len(strip)
    if at > 0xFFFFFFFF:
        raise FrameError("frame-too-large", "The resampled TIFF would be larger than 4 GB.")
    entry = writer.block.find(writer.block.first, _STRIPS)
    if entry is None:
        raise damaged("its directory could not be rebuilt")
    writer.block.put(f"{len(starts)}I", entry.value_at, *starts)
    return b"".join((bytes(out), *strips))


class _Writer:
    """Copies directories of one TIFF into a new one, values and all."""

    def __init__(self, source: TiffBlock) -> None:
        self.source = source
        self.block = TiffBlock(bytearray(source.data[:4] + b"\x00" * 4))
        self._copied = 0
        self._reserve_maker_note()

    def _reserve_maker_note(self) -> None:
        self.maker_note_at: Optional[int] = None
        exif = self.source.pointer(self.source.find(self.source.first, EXIF_IFD))
        note = self.source.find(exif, _MAKER_NOTE) if exif is not None else None
        if note is not None and note.length > 4 and 8 <= note.value_at <= 1 << 20:
            self.block.data.extend(b"\x00" * (note.value_at - 8))
            self.block.data += self.source.data[note.value_at : note.value_at + note.length]
            self.maker_note_at = note.value_at

    def directory(self, at: int, storage: Optional[Dict[int, Tuple[int, bytes]]] = None, depth: int = 0) -> int:
        """Copy the directory at ``at`` with what hangs on it and return its new offset.

        With ``storage`` it is the first directory: those tags replace its own.
        """
        below = ((EXIF_IFD, GPS_IFD), (INTEROP_IFD,), ())[depth]
        items: List[Tuple[int, int, bytes, Optional[int]]] = []
        for entry in {e.tag: e for e in reversed(self.source.entries(at)[0])}.values():
            if storage is not None and entry.tag in _LEFT_BEHIND:
                continue
            value = bytes(self.source.data[entry.value_at : entry.value_at + entry.length])
            place: Optional[int] = None
            if entry.tag in (EXIF_IFD, GPS_IFD, INTEROP_IFD):
                inner = self.source.pointer(entry)
                if inner is None or entry.tag not in below:
                    continue
                value = struct.pack(self.source.order + "I", self.directory(inner, depth=depth + 1))
            elif entry.tag == _MAKER_NOTE and entry.value_at == self.maker_note_at:
                place = entry.value_at
            self._copied += len(value)
            if self._copied > len(self.source.data):
                raise damaged("its values overlap")
            items.append((entry.tag, entry.kind, value, place))
        items.extend((tag, kind, value, None) for tag, (kind, value) in (storage or {}).items())
        items.sort()
        data, order = self.block.data, self.source.order
        data.extend(b"\x00" * (len(data) % 2))
        start = len(data)
        data.extend(struct.pack(order + "H", len(items)) + b"\x00" * (12 * len(items) + 4))
        for index, (tag, kind, value, place) in enumerate(items):
            spot = start + 2 + 12 * index
            struct.pack_into(order + "HHI", data, spot, tag, kind, len(value) // TYPE_BYTES[kind])
            if len(value) <= 4:
                data[spot + 8 : spot + 8 + len(value)] = value
                continue
            if place is None:
                data.extend(b"\x00" * (len(data) % 2))
                place = len(data)
                data += value
            struct.pack_into(order + "I", data, spot + 8, place)
        if storage is not None:
            self.block.put("I", 4, start)
        return start


def retag_tiff(data: bytes, edit: TagEdit) -> bytes:
    """Return the file with its focal tags edited; nothing else changes, a directory that must grow goes to the end."""
    block = TiffBlock(bytearray(data))
    edit_tags(block, edit)
    return bytes(block.data)
