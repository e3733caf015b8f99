"""What can happen to a finished file: a table of functions over its bytes."""

from __future__ import annotations

import io
from typing import Any, Callable, Dict, Mapping

Change = Callable[[bytes, Mapping[str, Any]], bytes]


def _truncate(data: bytes, arguments: Mapping[str, Any]) -> bytes:
    """The card was pulled: only a share of the file is there."""
    return data[: int(len(data) * float(arguments.get("share", 0.4)))]


def _empty(data: bytes, arguments: Mapping[str, Any]) -> bytes:
    return b""


def _text(data: bytes, arguments: Mapping[str, Any]) -> bytes:
    """A saved error page under the name of an image."""
    return b"<!DOCTYPE html>\n<html><body>404 Not Found</body></html>\n"


def _garble(data: bytes, arguments: Mapping[str, Any]) -> bytes:
    """A bad block in the header: directory and XMP are noise, the markers survive."""
    start, length = int(arguments.get("start", 40)), int(arguments.get("length", 400))
    noise = bytes((i * 73 + 41) % 251 for i in range(length))
    return data[:start] + noise + data[start + length :]


def _resize(data: bytes, arguments: Mapping[str, Any]) -> bytes:
    """The owner shrank the image with a tool that kept every tag as it was (so the focal-plane tags lie)."""
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        factor = float(arguments.get("factor", 0.5))
        size = (round(image.width * factor), round(image.height * factor))
        small = image.resize(size, Image.Resampling.BICUBIC)
        out = io.BytesIO()
        keep = {k: image.info[k] for k in ("exif", "xmp") if k in image.info}
        small.save(out, "JPEG", quality=92, **keep)
    return out.getvalue()


def _strip(data: bytes, arguments: Mapping[str, Any]) -> bytes:
    """Sent through a messenger: the pixels are there, every tag is gone."""
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        out = io.BytesIO()
        bare = Image.new(image.mode, image.size)
        bare.paste(image)
        bare.save(out, "JPEG", quality=85)
    return out.getvalue()


def _same(data: bytes, arguments: Mapping[str, Any]) -> bytes:
    return data


# ``copy`` leaves the file and writes its bytes to ``arguments["to"]``, ``rename`` moves it there, the others
# change it in place.
KINDS: Dict[str, Change] = {
    "truncate": _truncate,
    "empty": _empty,
    "text": _text,
    "garble": _garble,
    "resize": _resize,
    "strip": _strip,
    "copy": _same,
    "rename": _same,
}
