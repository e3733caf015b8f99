"""What the tests of the simulator share: small surveys and a reader of headers."""

from __future__ import annotations

from tests.simulator import Plan, Survey, catalogue, fly
from tests.simulator.places import GROUND


def flown_by(*payloads, plan=None, points=(), scene=GROUND, name="test"):
    plan = plan or Plan(height_m=40.0, strips=1, per_strip=2)
    shots = tuple(s for p in payloads for s in fly(p, plan, scene, 0))
    return Survey(name, (scene,), tuple(payloads), shots, tuple(points))


def strip_of(count=4):
    camera = catalogue.with_band_size(catalogue.phantom4pro(), 0.2)
    return flown_by(camera, plan=Plan(height_m=40.0, strips=1, per_strip=count))


def exif_of(path):
    from PIL import Image

    with Image.open(path) as image:
        exif = image.getexif()
        return image.size, exif, exif.get_ifd(0x8769), exif.get_ifd(0x8825), dict(image.info)
