"""The schema accepts what a report says and refuses what drifted."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any, Dict

import jsonschema
import pytest
from sensorgate.stages import elevation, intrinsics
from sensorgate.stages import profile as nouns
from sensorgate.stages.align import model

from tests.plugin.report.sample import empty, sample

SCHEMA = json.loads(
    (Path(__file__).resolve().parents[3] / "plugin/report/report.schema.json").read_text(encoding="utf-8")
)
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
COPIES = {
    "elevation": elevation.ElevationSource,
    "flight": nouns.Flight,
    "payload": nouns.Payload,
    "profile": nouns.CameraProfile,
    "intrinsics": intrinsics.Intrinsics,
    "candidate": model.Candidate,
    "payload_alignment": model.PayloadAlignment,
    "gps_fit": model.GpsFit,
    "bowing": model.Bowing,
}


def test_the_schema_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("report", [sample(), empty(), empty("consistent")], ids=["survey", "blocked", "consistent"])
def test_accepts_a_report(report: Dict[str, Any]) -> None:
    assert [e.message for e in VALIDATOR.iter_errors(report)] == []


def test_survives_json() -> None:
    VALIDATOR.validate(json.loads(json.dumps(sample(), allow_nan=False)))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("verdict",), "fine"),
        (("schema_version",), "2.0"),
        (("surprise",), 1),
        (("frames", 0, "surprise"), 1),
        (("frames", 0, "latitude"), 91.0),
        (("frames", 0, "role"), "tourist"),
        (("subprojects", 0, "route"), "perhaps"),
        (("subprojects", 0, "name"), "../escape"),
        (("subprojects", 0, "alignment", "surprise"), 1),
        (("findings", 0, "severity"), "fatal"),
        (("findings", 0, "code"), "Not A Code"),
        (("actions", 0, "scale"), 0),
        (("ignored",), {"hidden": -1}),
    ],
)
def test_refuses_what_drifted(place: Any, value: Any) -> None:
    report = sample()
    spot: Any = report
    for step in place[:-1]:
        spot = spot[step]
    spot[place[-1]] = value
    assert not VALIDATOR.is_valid(report)


@pytest.mark.parametrize("name", ["frames", "verdict", "findings", "subprojects", "thresholds", "inputs"])
def test_refuses_a_report_without(name: str) -> None:
    report = sample()
    del report[name]
    assert not VALIDATOR.is_valid(report)


@pytest.mark.parametrize("name", sorted(COPIES))
def test_follows_the_nouns(name: str) -> None:
    """What a report copies from a dataclass is described field by field."""
    fields = {f.name for f in dataclasses.fields(COPIES[name])}
    described = set(SCHEMA["$defs"][name]["properties"]) - {"odm_camera_ids"}
    assert described == fields


def test_solver_figures_state_their_tolerance() -> None:
    for name in ("registered", "mean_reproj_error_px", "gps_rmse_m", "height_m", "bowing_m"):
        said = SCHEMA["$defs"]["alignment"]["properties"][name]["description"]
        assert "between runs" in said
