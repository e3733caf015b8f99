"""XMP packets: forms, namespaces, encodings, and what is refused."""

from __future__ import annotations

import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensorgate.stages.headers import xmp
from sensorgate.stages.thresholds import DEFAULTS

from .build import packet

RDF = 'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"'
DJI = 'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'


def rdf(inner):
    return f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF {RDF}>{inner}</rdf:RDF></x:xmpmeta>'.encode()


def test_attribute_and_element_form_say_the_same():
    attribute = xmp.parse([packet(attributes='drone-dji:RtkFlag=" 50 "')])
    element = xmp.parse([packet("<drone-dji:RtkFlag>\n 50\n</drone-dji:RtkFlag>")])
    assert attribute.values == element.values == {"drone-dji:RtkFlag": "50"}


@pytest.mark.parametrize("kind", ["Seq", "Bag", "Alt"])
def test_lists(kind):
    items = '<rdf:li>Red</rdf:li><rdf:li xml:lang="x-default"> NIR </rdf:li>'
    body = f"<Camera:BandName><rdf:{kind}>{items}</rdf:{kind}></Camera:BandName>"
    assert xmp.parse([packet(body)]).values == {"Camera:BandName": ("Red", "NIR")}
    assert xmp.parse([packet(f"<Camera:BandName><rdf:{kind}/></Camera:BandName>")]).text("Camera:BandName") == ""


def test_prefixes_are_resolved_by_their_uri():
    inner = (
        '<rdf:Description xmlns:a="http://www.dji.com/drone-dji/1.0" xmlns:b="http://pix4d.com/1.0" a:RtkFlag="50"/>'
    )
    inner += (
        '<rdf:Description xmlns:b="http://micasense.com/MicaSense/1.0/"><b:CaptureId>x</b:CaptureId></rdf:Description>'
    )
    found = xmp.parse([rdf(inner)])
    assert found.values == {"drone-dji:RtkFlag": "50", "MicaSense:CaptureId": "x"}
    assert found.namespaces == ("MicaSense", "drone-dji")
    other_name = (
        f'<r:RDF xmlns:r="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><r:Description {DJI} drone-dji:A="1"/></r:RDF>'
    )
    assert xmp.parse([other_name.encode()]).values == {"drone-dji:A": "1"}


def test_unknown_uris_and_undeclared_prefixes_keep_the_prefix():
    inner = '<rdf:Description xmlns:Camera="http://vendor.example/2" Camera:BandName="Red" Sentera:Band="x"/>'
    assert xmp.parse([rdf(inner)]).values == {"Camera:BandName": "Red", "Sentera:Band": "x"}


def test_several_descriptions_are_counted_and_the_first_value_stands():
    found = xmp.parse(
        [rdf(f'<rdf:Description {DJI} drone-dji:A="1"/><rdf:Description {DJI} drone-dji:A="2" drone-dji:B="3"/>')]
    )
    assert found.values == {"drone-dji:A": "1", "drone-dji:B": "3"}
    assert (found.blocks, found.problems) == (2, ["xmp-multiple-descriptions:2"])


def test_structures_do_not_leak_their_fields():
    body = '<xmp:Thing rdf:parseType="Resource"><Camera:BandName>inner</Camera:BandName></xmp:Thing>'
    body += "<Camera:BandName>outer</Camera:BandName>"
    assert xmp.parse([packet(body)]).values["Camera:BandName"] == "outer"


def test_a_packet_that_is_not_utf8_is_told_and_read():
    latin = packet(attributes='drone-dji:RtkFlag="50" tiff:Make="Hasselblad"').replace(b"Hasselblad", b"Hasselbl\xe4d")
    found = xmp.parse([latin])
    assert found.values == {"drone-dji:RtkFlag": "50", "tiff:Make": "Hasselbläd"}
    assert found.problems == ["xmp-not-utf8:byte " + str(latin.index(b"\xe4"))]
    wide = packet(attributes='drone-dji:RtkFlag="50"').decode().encode("utf-16")
    assert xmp.parse([wide]).values == {"drone-dji:RtkFlag": "50"}
    assert xmp.parse([wide]).problems == ["xmp-not-utf8:utf-16"]


LAUGHS = b'<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
OUTSIDE = b'<!DOCTYPE x SYSTEM "file:///etc/passwd">'


@pytest.mark.parametrize("doctype", [LAUGHS, OUTSIDE])
def test_a_doctype_is_refused(doctype):
    found = xmp.parse([doctype + rdf(f'<rdf:Description {DJI} drone-dji:A="1">&b;</rdf:Description>')])
    assert (found.values, found.problems) == ({}, ["xmp-doctype:refused"])


def test_what_stands_before_the_damage_is_kept():
    whole = rdf(
        f'<rdf:Description {DJI} drone-dji:A="1"><drone-dji:B>2</drone-dji:B>'
        "<drone-dji:C>3</drone-dji:C></rdf:Description>"
    )
    found = xmp.parse([whole[: whole.index(b"<drone-dji:C>") + 20]])
    assert found.values == {"drone-dji:A": "1", "drone-dji:B": "2"}
    assert len(found.problems) == 1 and found.problems[0].startswith("xmp-malformed:")
    assert xmp.parse([b"no markup here"]).problems == ["xmp-malformed:no markup"]
    assert xmp.parse([b"  \x00 "]).problems in ([], ["xmp-malformed:no markup"])


def test_padding_and_what_follows_the_packet_do_no_harm():
    data = packet(attributes='drone-dji:RtkFlag="50"')
    assert xmp.parse([data + b" \n" * 4000 + b"\x00" * 9]).problems == []
    assert xmp.parse([data + data]).problems == []


@pytest.mark.parametrize(
    "bomb",
    [
        rdf("<rdf:Description>" + "<a:b/>" * 600_000 + "</rdf:Description>"),
        rdf("<rdf:Description " + " ".join(f'a:a{i}="1"' for i in range(280_000)) + "/>"),
        rdf("<rdf:Description><a:b>" + "&#65;" * 700_000 + "</a:b></rdf:Description>"),
        b"<a>" * 1_000_000,
        rdf("<rdf:Description a:b='" + "x" * 4_000_000 + "'/>"),
        b"<" + b"\xff" * 4_000_000 + b">",
        rdf("<rdf:Description>" + "".join(f"<a:b{i} c:d='1' c:d='2'/>" for i in range(5000)) + "</rdf:Description>"),
    ],
    ids=["elements", "attributes", "references", "depth", "value", "bytes", "repairs"],
)
def test_a_bomb_takes_bounded_time(bomb):
    before = time.process_time()
    xmp.parse([bomb])
    assert time.process_time() - before < 0.25  # measured below 0.05; a loaded machine is slower


def test_a_packet_over_the_limit_is_not_parsed():
    big = packet(attributes=f'drone-dji:RtkFlag="50" drone-dji:Pad="{"x" * DEFAULTS.max_xmp_bytes}"')
    found = xmp.parse([big])
    assert found.values == {} and found.problems[0].startswith("xmp-too-large:")


names = st.text(alphabet=st.characters(min_codepoint=97, max_codepoint=122), min_size=1, max_size=8)
values = st.text(alphabet=st.characters(blacklist_categories=("Cs", "Cc"), max_codepoint=0xFFFF), max_size=20).map(
    lambda t: t.replace("\ufffe", "").replace("\uffff", "").strip()
)


def escaped(text):
    for raw, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        text = text.replace(raw, entity)
    return text


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(names, values, max_size=6))
def test_any_values_come_back_in_either_form(told):
    attributes = " ".join(f'drone-dji:{n}="{escaped(v)}"' for n, v in told.items())
    elements = "".join(f"<drone-dji:{n}>{escaped(v)}</drone-dji:{n}>" for n, v in told.items())
    expected = {f"drone-dji:{n}": v for n, v in told.items()}
    assert xmp.parse([packet(attributes=attributes)]).values == expected
    assert xmp.parse([packet(elements)]).values == expected


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 400))
def test_no_bytes_make_it_raise(junk, at):
    whole = packet(attributes='drone-dji:RtkFlag="50"')
    xmp.parse([whole[:at] + junk + whole[at:]])
    xmp.parse([junk])
