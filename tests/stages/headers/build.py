"""Small image files for the tests, byte by byte where libraries would tidy the fault away."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
from PIL import Image
from sensorgate.stages.read import frame_from_header

REAL = Path(__file__).resolve().parents[3].parent / "shared/data/real_frames"

SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 9: 4, 10: 8, 11: 4, 12: 8, 16: 8}
CODES = {1: "B", 3: "H", 4: "I", 9: "i", 11: "f", 12: "d", 16: "Q"}

ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL, FLOAT, DOUBLE = 2, 3, 4, 5, 7, 10, 11, 12


def encode(kind, value, order):
    """(count, bytes) of a value; rationals are (numerator, denominator) pairs."""
    if isinstance(value, (bytes, str)):
        data = value if isinstance(value, bytes) else value.encode() + b"\x00"
        return len(data), data
    values = (
        value if isinstance(value, (list, tuple)) and not (kind in (5, 10) and isinstance(value[0], int)) else [value]
    )
    if kind in (5, 10):
        code = "I" if kind == 5 else "i"
        return len(values), b"".join(struct.pack(order + 2 * code, *v) for v in values)
    return len(values), b"".join(struct.pack(order + CODES[kind], v) for v in values)


def ifd_block(tags, at, order="<", big=False, following=0):
    """A directory and its values as they stand at offset ``at``; tags are (number, type, value)."""
    count_code, entry, inline = ("Q", 20, 8) if big else ("H", 12, 4)
    head = struct.calcsize("<" + count_code) + entry * len(tags) + inline
    body, rows = b"", b""
    for number, kind, value in sorted(tags, key=lambda t: t[0]):
        count, data = encode(kind, value, order)
        if len(data) <= inline:
            field = data.ljust(inline, b"\x00")
        else:
            field = struct.pack(order + ("Q" if big else "I"), at + head + len(body))
            body += data + b"\x00" * (len(data) % 2)
        rows += struct.pack(order + ("HHQ" if big else "HHI"), number, kind, count) + field
    return (
        struct.pack(order + count_code, len(tags)) + rows + struct.pack(order + ("Q" if big else "I"), following) + body
    )


def exif_stream(image=(), exif=(), gps=(), order="<"):
    """The TIFF stream of an Exif block."""
    image = list(image)
    for _ in range(2):  # the first round finds where the directories come to stand
        first = ifd_block([t for t in image if t[0] not in (0x8769, 0x8825)]
                          + [(0x8769, LONG, 0)] * bool(exif) + [(0x8825, LONG, 0)] * bool(gps), 8, order)  # fmt: skip
        exif_at = 8 + len(first)
        exif_bytes = ifd_block(list(exif), exif_at, order) if exif else b""
        gps_at = exif_at + len(exif_bytes)
        gps_bytes = ifd_block(list(gps), gps_at, order) if gps else b""
        pointers = [(0x8769, LONG, exif_at)] * bool(exif) + [(0x8825, LONG, gps_at)] * bool(gps)
        first = ifd_block(image + pointers, 8, order)
    magic = b"II*\x00" if order == "<" else b"MM\x00*"
    return magic + struct.pack(order + "I", 8) + first + exif_bytes + gps_bytes


def tiff_file(image=(), exif=(), gps=(), *, size=(6, 4), order="<", big=False, bits=16, extra_pages=(), first_kind=0):
    """A mono TIFF: header, pixels, and every directory behind them.

    ``extra_pages`` are (width, height, NewSubfileType) of further directories
    that share the pixels; ``first_kind`` is the type of the first.
    """
    data_at = 16 if big else 8
    pixels = bytes(1 + i % 255 for i in range(size[0] * size[1] * bits // 8))
    body = b""
    pointers = []

    def here():
        return data_at + len(pixels) + len(body)

    for number, rows in ((0x8769, exif), (0x8825, gps)):
        if rows:
            pointers.append((number, LONG, here()))
            body += ifd_block(list(rows), here(), order, big)
    first_at = here()
    pages = [(*size, first_kind, [*image, *pointers])] + [(*p, []) for p in extra_pages]
    for index, (width, height, kind, more) in enumerate(pages):
        tags = [(254, LONG, kind), (256, LONG, width), (257, LONG, height), (258, SHORT, bits), (259, SHORT, 1),
                (262, SHORT, 1), (273, LONG, data_at), (277, SHORT, 1), (278, LONG, height),
                (279, LONG, len(pixels)), *more]  # fmt: skip
        following = here() + len(ifd_block(tags, here(), order, big))
        body += ifd_block(tags, here(), order, big, following if index + 1 < len(pages) else 0)
    start = b"II" if order == "<" else b"MM"
    start += struct.pack(order + "HHHQ", 43, 8, 0, first_at) if big else struct.pack(order + "HI", 42, first_at)
    return start + pixels + body


def segment(marker, payload):
    return b"\xff" + bytes([marker]) + struct.pack(">H", len(payload) + 2) + payload


def jpeg_file(exif=b"", xmp=b"", *, size=(64, 48), mode="RGB", segments=(), tail=b"", restart=0):
    """A real JPEG with an Exif block, an XMP packet and further segments before its picture."""
    buffer = io.BytesIO()
    noise = np.random.default_rng(7).integers(0, 256, (size[1], size[0]), np.uint8)
    picture = Image.fromarray(noise).convert(mode)
    picture.save(buffer, "JPEG", quality=90, **({"restart_marker_blocks": restart} if restart else {}))
    plain = buffer.getvalue()
    head = plain[:2]
    if exif:
        head += segment(0xE1, b"Exif\x00\x00" + exif)
    if xmp:
        head += segment(0xE1, b"http://ns.adobe.com/xap/1.0/\x00" + xmp)
    for marker, payload in segments:
        head += segment(marker, payload)
    return head + plain[2:] + tail


def packet(body="", attributes="", namespaces=""):
    """An XMP packet with one description."""
    known = {
        "drone-dji": "http://www.dji.com/drone-dji/1.0/", "Camera": "http://pix4d.com/camera/1.0/",
        "MicaSense": "http://micasense.com/MicaSense/1.0/", "tiff": "http://ns.adobe.com/tiff/1.0/",
        "exif": "http://ns.adobe.com/exif/1.0/", "aux": "http://ns.adobe.com/exif/1.0/aux/",
        "xmp": "http://ns.adobe.com/xap/1.0/", "xmpNote": "http://ns.adobe.com/xmp/note/",
        "FLIR": "http://ns.flir.com/xmp/1.0/",
    }  # fmt: skip
    declared = namespaces or " ".join(f'xmlns:{p}="{u}"' for p, u in known.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" {declared} {attributes}>{body}</rdf:Description></rdf:RDF></x:xmpmeta>'
        '<?xpacket end="w"?>'
    ).encode()


def read(data, name="a.jpg"):
    """The frame of a file that is all in memory."""
    return frame_from_header(name, {0: data}, len(data))


def with_xmp(attributes="", body="", exif=b"", **jpeg):
    return read(jpeg_file(exif, packet(body, attributes), **jpeg))
