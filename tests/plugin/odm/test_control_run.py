"""Ground control and positions through a whole run, read back by ODM's rules and held against what was rendered.

The frames of one drone are resampled and have blanks in their names, so all
that stands in a list changes: names and pixels.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np
import pytest

pytest.importorskip("cv2")

from PIL import Image
from sensorgate.plugin import pipeline

from tests import simulator
from tests.simulator.camera import Camera, project
from tests.simulator.truth import TrueFrame, Truth

# Marks are written to a thousandth of a pixel, heights of frames are rounded to whole pixels.
MARK_PX = 0.5


class Rendered:
    """A survey of two drones over hills with control; the coarse drone's names hold blanks."""

    def __init__(self, folder: Path) -> None:
        self.truth: Truth = simulator.render("control-forced", folder, frames_scale=0.5)
        self.images = folder / "images"
        self.renamed: Dict[str, str] = {}
        for frame in self.truth.frames:
            path = self.images / frame.path
            name = path.name.replace("_", " ") if frame.payload == "p4" else path.name
            path.rename(path.with_name(name))
            self.renamed[name] = frame.path
        rows = (folder / str(self.truth.gcp_file)).read_text(encoding="utf-8").splitlines()
        back = {old.rsplit("/", 1)[-1]: new for new, old in self.renamed.items()}
        self.gcp = folder / "control.txt"
        listed = ["\t".join([*r.split()[:5], back[r.split()[5]], *r.split()[6:]]) for r in rows[1:]]
        self.gcp.write_text("\n".join([rows[0], *listed]) + "\n", encoding="utf-8")

    def run(self, out: Path, **settings: Any) -> Tuple[Dict[str, Any], Path]:
        """The report and the folder of the one project; without alignment, which has no say in what is written."""
        done = pipeline.run([str(self.images)], out, pipeline.Settings(align=False, **settings))
        (told,) = done.report["subprojects"]
        return done.report, out / "projects" / told["name"]


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Rendered:
    return Rendered(tmp_path_factory.mktemp("control"))


def camera_of(frame: TrueFrame, width: int, height: int) -> Camera:
    """The frame's true camera at the size that was written."""
    scale = width / frame.camera.width
    return Camera(
        width=width,
        height=height,
        focal_ratio=frame.camera.focal_ratio,
        center_px=(frame.camera.center_px[0] * scale, frame.camera.center_px[1] * scale),
        distortion=frame.camera.distortion,
    )


def as_odm_reads(text: str) -> Tuple[str, List[List[str]]]:
    """Header and rows by ODM's rules: everything parted by blanks, so a name with one would shift the columns."""
    lines = [line.strip() for line in text.strip().split("\n")]
    return lines[0], [line.split() for line in lines[1:] if line and line[0] != "#"]


def test_forced_control_lies_on_the_truth_in_renamed_and_resampled_frames(rendered: Rendered, tmp_path: Path) -> None:
    report, folder = rendered.run(tmp_path / "out", gcp=str(rendered.gcp), force_gcp=True)
    options = {o["name"] for o in report["subprojects"][0]["options"]}
    assert not options & {"use-exif", "force-gps", "force-gcp"}
    header, rows = as_odm_reads((folder / "gcp_list.txt").read_text(encoding="utf-8"))
    assert header == rendered.gcp.read_text(encoding="utf-8").splitlines()[0]
    source = {Path(f["output"]).name: rendered.renamed[Path(f["path"]).name] for f in report["frames"] if f["output"]}
    truth = {f.path: f for f in rendered.truth.frames}
    points = {p.id: p for p in rendered.truth.points}
    seen = {"p4": 0, "p4p": 0}
    for x, y, _, px, py, name, point in rows:
        assert (float(x), float(y)) != (0.0, 0.0) and not point.startswith("check")
        frame = truth[source[name]]
        with Image.open(folder / "images" / name) as image:
            camera = camera_of(frame, *image.size)
            scale = image.size[0] / frame.camera.width
        assert (scale > 1.3) == (frame.payload == "p4")
        place = np.asarray([[points[point].east_m, points[point].north_m, points[point].up_m]])
        there = project(place, camera, np.asarray(frame.rotation), np.asarray(frame.center_m))[0]
        assert np.hypot(*(there - (float(px), float(py)))) <= MARK_PX, (name, point)
        seen[frame.payload] += 1
    assert min(seen.values()) >= 10
    assert any(" " in Path(f["path"]).name and " " not in f["output"] for f in report["frames"])


def test_unforced_control_beside_rtk_keeps_gps(rendered: Rendered, tmp_path: Path) -> None:
    report, folder = rendered.run(tmp_path / "out", gcp=str(rendered.gcp))
    assert (folder / "gcp_list.txt").exists()
    assert "force-gps" in {o["name"] for o in report["subprojects"][0]["options"]}


def test_too_few_points_leave_gps_on_and_are_said(rendered: Rendered, tmp_path: Path) -> None:
    rows = rendered.gcp.read_text(encoding="utf-8").splitlines()
    four = [r for r in rows[1:] if r.split("\t")[6] in ("gcp01", "gcp02", "gcp03", "gcp04")]
    few = tmp_path / "few.txt"
    few.write_text("\n".join([rows[0], *four]) + "\n", encoding="utf-8")
    report, folder = rendered.run(tmp_path / "out", gcp=str(few), force_gcp=True)
    assert not (folder / "gcp_list.txt").exists()
    (said,) = [f for f in report["findings"] if f["code"] == "gcp-few-points"]
    assert (said["measured"], said["threshold"]) == (4.0, 5.0) and "align" in said["remedy"]
    assert not {"force-gps", "use-exif"} & {o["name"] for o in report["subprojects"][0]["options"]}


def test_positions_of_mixed_accuracy_reach_odm_per_image(rendered: Rendered, tmp_path: Path) -> None:
    names = sorted(rendered.renamed)
    truth = {f.path: f for f in rendered.truth.frames}
    rows = ["EPSG:4326"]
    for name in names:
        frame = truth[rendered.renamed[name]]
        if " " in name:
            continue  # no geo.txt can name them: ODM parts its lines at blanks
        sigma = "0.02 0.04" if int(name[-5]) % 2 else "2.5 5.0"
        rows.append(f"{name} {frame.longitude:.9f} {frame.latitude:.9f} {frame.altitude_m + 7:.3f} nan nan nan {sigma}")
    geo = tmp_path / "geo.txt"
    geo.write_text("\n".join(rows) + "\n", encoding="utf-8")
    report, folder = rendered.run(tmp_path / "out", geo=str(geo))
    header, read = as_odm_reads((folder / "geo.txt").read_text(encoding="utf-8"))
    assert header == "EPSG:4326" and len(read) == len(rows) - 1
    images = {p.name for p in (folder / "images").iterdir()}
    for name, lon, lat, up, *angles, flat, high in read:
        assert name in images and angles == ["nan"] * 3
        assert (float(flat), float(high)) == ((0.02, 0.04) if int(name[-5]) % 2 else (2.5, 5.0))
        frame = truth[rendered.renamed[name]]
        assert float(lon) == pytest.approx(frame.longitude) and float(lat) == pytest.approx(frame.latitude)
        assert float(up) == pytest.approx(frame.altitude_m + 7, abs=1e-3)
    assert "gps-accuracy" not in {o["name"] for o in json.loads((folder / "sensorgate/options.json").read_text())}
    told = {Path(f["path"]).name: f["altitude_m"] for f in report["frames"]}
    assert all(told[n] == pytest.approx(float(u), abs=1e-3) for n, _, _, u, *_ in read)
