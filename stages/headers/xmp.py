"""XMP packets: properties by canonical prefix, parsed by expat with any doctype refused.

Attribute and element form, any number of ``rdf:Description`` blocks, Seq, Bag
and Alt. Prefixes are resolved by namespace URI; an unknown URI keeps the
prefix that the file gave it, because vendors spell theirs in several ways.
Reference: Adobe XMP specification parts 1 and 3.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional, Sequence, Tuple, Union
from xml.parsers import expat

from ..thresholds import DEFAULTS, Thresholds

Property = Union[str, Tuple[str, ...]]

_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns"
_PREFIXES = {
    _RDF: "rdf",
    "adobe:ns:meta": "x",
    "http://ns.adobe.com/tiff/1.0": "tiff",
    "http://ns.adobe.com/exif/1.0": "exif",
    "http://ns.adobe.com/exif/1.0/aux": "aux",
    "http://cipa.jp/exif/1.0": "exifEX",
    "http://ns.adobe.com/xap/1.0": "xmp",
    "http://ns.adobe.com/xap/1.0/mm": "xmpMM",
    "http://ns.adobe.com/xmp/note": "xmpNote",
    "http://ns.adobe.com/camera-raw-settings/1.0": "crs",
    "http://purl.org/dc/elements/1.1": "dc",
    "http://www.dji.com/drone-dji/1.0": "drone-dji",
    "http://www.dji.com": "DJI",
    "http://www.dji.com/flir/1.0": "FLIR",
    "http://ns.flir.com/xmp/1.0": "FLIR",
    "http://pix4d.com/camera/1.0": "Camera",
    "http://pix4d.com/1.0": "Camera",
    "http://micasense.com/micasense/1.0": "MicaSense",
    "http://micasense.com/dls/1.0": "DLS",
    "http://ns.sensefly.com/sensefly/1.0": "sensefly",
}
_UNLISTED = frozenset(("rdf", "x", "xml", "xmlns", ""))
_ATTRIBUTE = re.compile(rb"""\s*[^\s=<>/"']+\s*=\s*(?:"[^"<]*"|'[^'<]*')""")
_MAX_DEPTH = 64
_MAX_REPAIRS = 4
_DUPLICATE_ATTRIBUTE = 8
_JUNK_AFTER_ROOT = 9


@dataclass
class Xmp:
    """What the packets of a file say. ``blocks`` counts top-level ``rdf:Description`` elements."""

    values: Dict[str, Property] = field(default_factory=dict)
    namespaces: Tuple[str, ...] = ()
    blocks: int = 0
    problems: List[str] = field(default_factory=list)

    def items(self, *names: str) -> Tuple[str, ...]:
        """The list of the first property there is; a single text is a list of one."""
        for name in names:
            value = self.values.get(name)
            if value:
                return (value,) if isinstance(value, str) else value
        return ()

    def text(self, *names: str) -> str:
        """The text of the first property there is; a list gives its first entry."""
        items = self.items(*names)
        return items[0] if items else ""

    def extend(self, more: "Xmp") -> None:
        """Add what ``more`` has and this has not; blocks are not added, as other readers see only the first packet."""
        for key, value in more.values.items():
            if not self.values.get(key):
                self.values[key] = value
        self.namespaces = tuple(sorted({*self.namespaces, *more.namespaces}))
        self.problems += [p for p in more.problems if not p.startswith("xmp-multiple-descriptions")]


class _Refused(Exception):
    pass


def parse(packets: Sequence[bytes], limits: Thresholds = DEFAULTS) -> Xmp:
    """Parse the packets of one file; of a repeated property the first counts.

    Never raises on what a packet holds: what cannot be read is in ``problems``
    (``xmp-doctype``, ``xmp-malformed``, ``xmp-not-utf8``, ``xmp-too-large``,
    ``xmp-multiple-descriptions``) and what came before it is kept.
    """
    result = Xmp()
    used: Dict[str, None] = {}
    properties = 0
    for packet in packets:
        properties += packet.count(b"<") + (packet.count(b'"') + packet.count(b"'")) // 2
        if len(packet) <= limits.max_xmp_bytes:
            packet = _as_utf8(packet, result.problems)
        if len(packet) > limits.max_xmp_bytes or properties > limits.max_xmp_properties:
            result.problems.append(f"xmp-too-large:{len(packet)} bytes, {properties} properties")
            break
        _parse_one(packet, result, used)
    result.namespaces = tuple(sorted(used))
    if result.blocks > 1:
        result.problems.append(f"xmp-multiple-descriptions:{result.blocks}")
    return result


def _parse_one(packet: bytes, result: Xmp, used: Dict[str, None]) -> None:
    start, end = packet.find(b"<"), packet.rfind(b">")
    if start < 0 or end < start:
        if packet.strip():
            result.problems.append("xmp-malformed:no markup")
        return
    packet = packet[start : end + 1]
    for _ in range(_MAX_REPAIRS):
        handler = _Handler(dict(result.values))
        error = handler.run(packet)
        if error is None or error.code == _JUNK_AFTER_ROOT:
            break
        result.problems.append(f"xmp-malformed:{expat.ErrorString(error.code)}")
        match = _ATTRIBUTE.match(packet, handler.error_at) if error.code == _DUPLICATE_ATTRIBUTE else None
        if match is None:
            break
        packet = packet[: match.start()] + packet[match.end() :]
    if handler.refused:
        result.problems.append(handler.refused)
    result.values = handler.values
    result.blocks += handler.blocks
    used.update(handler.used)


def _as_utf8(packet: bytes, problems: List[str]) -> bytes:
    for mark, encoding in ((b"\xff\xfe\x00\x00", "utf-32"), (b"\x00\x00\xfe\xff", "utf-32"),
                           (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):  # fmt: skip
        if packet.startswith(mark):
            problems.append(f"xmp-not-utf8:{encoding}")
            return packet.decode(encoding, "replace").encode("utf-8", "replace")
    for mark, encoding in ((b"<\x00", "utf-16-le"), (b"\x00<", "utf-16-be")):
        if packet.startswith(mark):
            problems.append(f"xmp-not-utf8:{encoding}")
            return packet.decode(encoding, "replace").encode("utf-8", "replace")
    try:
        packet.decode("utf-8")
    except UnicodeDecodeError as error:
        problems.append(f"xmp-not-utf8:byte {error.start}")
        return packet.decode("latin-1").encode("utf-8")
    return packet


class _Handler:
    """Collects properties while expat walks one packet."""

    def __init__(self, values: Dict[str, Property]) -> None:
        self.values = values
        self.used: Dict[str, None] = {}
        self.blocks = 0
        self.refused = ""
        self.error_at = 0
        self._depth = 0
        self._rdf_depth = 0
        self._scope: Dict[str, str] = {}
        self._scopes: List[Tuple[int, Dict[str, str]]] = []
        self._key = ""
        self._items: Optional[List[str]] = None
        self._text: List[str] = []

    def run(self, packet: bytes) -> Optional[expat.ExpatError]:
        """Parse; return the error where the packet stops making sense."""
        parser = expat.ParserCreate("UTF-8")
        parser.buffer_text = True
        parser.ordered_attributes = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._doctype
        try:
            parser.Parse(packet, True)
        except expat.ExpatError as error:
            self.error_at = parser.ErrorByteIndex
            return error
        except _Refused:
            pass
        return None

    def _doctype(self, *_: Any) -> None:
        self.refused = "xmp-doctype:refused"
        raise _Refused

    def _canonical(self, name: str) -> str:
        prefix, colon, local = name.partition(":")
        if not colon:
            return name
        prefix = self._scope.get(prefix, prefix)
        return f"{prefix}:{local}"

    def _start(self, name: str, attributes: List[str]) -> None:
        self._depth += 1
        depth = self._depth
        if depth > _MAX_DEPTH:
            self.refused = "xmp-malformed:nested too deeply"
            raise _Refused
        declared = {
            attributes[i][6:]: _PREFIXES.get(attributes[i + 1].rstrip("/#").lower(), attributes[i][6:])
            for i in range(0, len(attributes), 2)
            if attributes[i].startswith("xmlns:")
        }
        if declared:
            self._scopes.append((depth, self._scope))
            self._scope = {**self._scope, **declared}
        if not self._rdf_depth:
            if self._canonical(name) == "rdf:RDF":
                self._rdf_depth = depth
            return
        inside = depth - self._rdf_depth
        if inside == 1:
            self.blocks += 1
            for i in range(0, len(attributes), 2):
                if not attributes[i].startswith("xml"):
                    self._put(self._canonical(attributes[i]), attributes[i + 1].strip())
        elif inside == 2:
            self._key = self._canonical(name)
            self._items = None
            self._text = []
        else:
            kind = self._canonical(name)
            if kind == "rdf:li":
                self._items = [] if self._items is None else self._items
            self._text = []

    def _end(self, name: str) -> None:
        inside = self._depth - self._rdf_depth if self._rdf_depth else 0
        if inside == 2:
            text = "".join(self._text).strip()
            self._put(self._key, text if self._items is None else tuple(self._items))
            self._text = []
        elif inside > 2:
            if self._items is not None and self._canonical(name) == "rdf:li":
                self._items.append("".join(self._text).strip())
            self._text = []
        elif self._rdf_depth and inside == 0:
            self._rdf_depth = 0
        if self._scopes and self._scopes[-1][0] == self._depth:
            self._scope = self._scopes.pop()[1]
        self._depth -= 1

    def _characters(self, text: str) -> None:
        if self._rdf_depth:
            self._text.append(text)

    def _put(self, key: str, value: Property) -> None:
        prefix = key.partition(":")[0]
        if prefix in _UNLISTED:
            return
        self.used[prefix] = None
        if not self.values.get(key):
            self.values[key] = value
