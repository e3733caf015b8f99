"""An adapter to other software: one list of image files per project, out of what ``run`` wrote.

    python docs/examples/own_adapter.py RESULT OUT

An adapter reads ``report.json``, ``plan.json`` and the project folders. It needs none of sensorgate's modules, and no
stage knows of it. This one writes ``NAME.txt`` with the images of every proven project, and ``NAME.cameras.csv`` with
the focal lengths that the proof found, in pixels.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path


def main(result: Path, out: Path) -> int:
    """Write the lists; 1 where nothing is proven."""
    report = json.loads((result / "report.json").read_text(encoding="utf-8"))
    size = {p["id"]: (p["width"], p["height"]) for p in report["profiles"]}
    copies = {f["path"]: f["output"] for f in report["frames"] if f["output"]}
    out.mkdir(parents=True, exist_ok=True)
    proven = [p for p in report["subprojects"] if p["route"] != "unproven"]
    for project in proven:
        images = [str((result / copies[path]).resolve()) for path in project["frames"]]
        (out / f"{project['name']}.txt").write_text("\n".join(images) + "\n", encoding="utf-8")
        with open(out / f"{project['name']}.cameras.csv", "w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            table.writerow(["profile", "focal_px_of_the_original", "source", "held"])
            for camera in project["calibration"]:
                if camera["focal_ratio"] is not None:
                    focal_px = camera["focal_ratio"] * max(size[camera["profile"]])
                    table.writerow([camera["profile"], f"{focal_px:.1f}", camera["source"], camera["held"]])
        print(f"{project['name']}: {len(images)} images")
    return 0 if proven else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
