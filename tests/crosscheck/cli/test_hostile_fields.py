"""Hostile values in every field of scenes, baselines, loop files and tables: refused in one line, or read.

The schemas that read the files say which fields there are. Some hundred inputs are tried by default, all with
the slow tests; `-s` shows how many there are of each kind.
"""

from __future__ import annotations

import json
import random
from collections import Counter
from itertools import product

import numpy as np
import pytest
from command_line import short_example
from elements import ELEMENTS
from hostile_schemas import PLACE, VALUES, attempt, distinct, fields, fields_with_values, template

from crosscheck.library import load
from crosscheck.library.entries import SCENE
from crosscheck.library.scene_file import _scene_content, read_scene
from crosscheck.library.size import check_scene
from crosscheck.regress.baseline import Baseline, read_baseline
from crosscheck.regress.run import usual_path
from crosscheck.solar.wind import wind_over_day
from newton_euler import Scene, simulate
from newton_euler.analysis.identification.measurements import Measurements, measurements_from_csv
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.moving_base import base_motion_from_csv
from urdf.loops import LOOP_FILE_KEYS, Loops, parse_loops

SAMPLED = pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.slow), 41])
"""All inputs, or one of 41: no period of the lists of values."""


def scene_contents() -> dict[str, dict]:
    """Contents of scene files that hold entries of every kind."""
    found = {name: _scene_content(scene) for name, scene in ELEMENTS.items()}
    found |= {
        name: _scene_content(load(name))
        for name in ("tracker_on_boat", "tracker_wind", "slider_crank", "tracker_computed_torque")
    }
    loop, feedback = short_example(), short_example()
    loop["bodies"][0]["shapes"] = [
        {"kind": "cylinder", "start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 0.2], "radius": 0.01},
        {"kind": "sphere", "center": [0.0, 0.0, 0.2], "radius": 0.02},
    ]
    loop["armatures"] = [{"joint": "motor", "inertia": 1e-3, "coordinate": 0}]
    loop["forces"] = [{"kind": "ball_spring", "joint": "elbow", "stiffness": 0.1, "damping": 0.01}]
    loop["control"] = [{"kind": "digital", "period": 0.01, "law": loop["control"][0]}]
    loop["initial_state"] = {"crank": {"position": [0.0, 0.0, 0.1]}}
    spline = {"kind": "spline", "times": [0.0, 0.5, 1.0], "values": [0.0, 0.1, 0.3]}
    feedback["control"] = [
        {"kind": "state_feedback", "joint": "motor", "gains": {"motor": [5.0, 0.5]}, "target": spline}
    ]
    steps = {"kind": "steps", "times": [0.0, 0.5], "values": [0.0, 0.1]}
    feedback["control"][0]["feedforward"] = steps
    moves = {"kind": "moves", "times": [0.0, 0.5], "values": [0.0, 0.1], "ramps": [0.1]}
    loop["control"] = [{**loop["control"][0], "law": {**loop["control"][0]["law"], "target": moves}}]
    feedback["couplings"] = [
        {"kind": "linear", "name": "sum", "terms": [["motor", 0, 1.0], ["pivot", 0, 1.0]]}
    ]
    return {"loop": loop, "feedback": feedback} | found


def is_finite(scene: Scene) -> bool:
    state = initial_state(scene)
    numbers = (state.position, state.quaternion, state.linear_velocity, state.angular_velocity)
    return all(np.isfinite(each).all() for each in (*numbers, scene.gravity, scene.duration))


def test_every_field_of_a_scene_file_is_tried():
    schema = SCENE.model_json_schema()
    assert fields(schema) - distinct(schema, scene_contents()).keys() == set()


@pytest.mark.slow
@SAMPLED
@pytest.mark.parametrize("language", ["json", "yaml"])
def test_values_in_every_field_of_a_scene_file(tmp_path, language, step):
    path, counts = tmp_path / f"scene.{language}", Counter()
    for name, text in fields_with_values(SCENE.model_json_schema(), scene_contents(), language, step):
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        found = attempt(lambda: read_scene(str(path)))
        counts["refused" if found is None else "accepted"] += 1
        assert found is None or is_finite(found), name
    print(f"scenes, {language}: {dict(counts)}")
    assert counts["refused"] > 5 * counts["accepted"] > 0


@pytest.mark.slow
def test_scenes_with_hostile_values_run_to_finite_numbers_or_are_refused(tmp_path):
    path, counts = tmp_path / "scene.json", Counter()
    for name, text in fields_with_values(SCENE.model_json_schema(), scene_contents(), "json", 7):
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        scene = attempt(lambda: read_scene(str(path)))
        if scene is None or attempt(lambda scene=scene: check_scene(scene) or True) is None:
            continue
        run = attempt(lambda scene=scene: simulate(scene, most_steps=2000))
        if run is None:
            counts["refused"] += 1
            continue
        assert np.isfinite(run.position).all(), name
        assert np.isfinite(run.quaternion).all(), name
        counts["run"] += 1
    print(f"runs of scenes: {dict(counts)}")
    assert counts["run"] > 20


@SAMPLED
def test_values_in_every_field_of_a_baseline(tmp_path, step):
    """What is damaged is refused, whatever its form; a value that is the stored one in other words is not."""
    path, counts = tmp_path / "base.json", Counter()
    stored = read_baseline(usual_path("pendulum"))
    whole = json.loads(stored.text())
    for name, text in fields_with_values(Baseline.model_json_schema(), {"pendulum": whole}, "json", step):
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        found = attempt(lambda: read_baseline(path))
        counts["refused" if found is None else "accepted"] += 1
        assert found in (None, stored), name
    print(f"baselines, fields: {dict(counts)}")
    assert counts["refused"] > 10


@SAMPLED
def test_damaged_baselines_are_never_compared(tmp_path, step):
    """Of lost lines, exchanged digits and lines, and flipped bits none leaves a baseline that is read."""
    path, dice = tmp_path / "base.json", random.Random(3)
    stored = read_baseline(usual_path("pendulum"))
    text = stored.text()
    lines = text.splitlines(keepends=True)
    digits = [k for k, letter in enumerate(text) if letter in "123456789"]
    damaged: list[bytes] = []
    damaged += ["".join(lines[:k] + lines[k + 1 :]).encode() for k in range(1, len(lines) - 1)]
    for _ in range(2000):
        k = dice.choice(digits)
        damaged.append((text[:k] + str((int(text[k]) + 1) % 10) + text[k + 1 :]).encode())
        content = bytearray(text.encode())
        content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
        damaged.append(bytes(content))
    for content in damaged[::step]:
        path.write_bytes(content)
        assert attempt(lambda: read_baseline(path)) in (None, stored)
    print(f"baselines, damaged: {len(damaged[::step])}")


@SAMPLED
def test_values_in_every_field_of_a_loop_file(step):
    content = {
        "closed_loop": [["tip", "end"]], "type": ["3d"], "name_mot": ["motor"], "joint_name": ["elbow"],
        "joint_type": ["SPHERICAL"], "coupled": [{"motor": 1.0, "elbow": [0.5, 0.1]}],
    }  # fmt: skip
    paths = [
        *((key,) for key in LOOP_FILE_KEYS),
        *((key, 0) for key in LOOP_FILE_KEYS),
        ("closed_loop", 0, 0),
        ("coupled", 0, "motor"),
    ]
    paths += [("coupled", 0, "elbow", 1), ("more",)]
    texts = [template(content, path, "yaml") for path in paths]
    counts = Counter()
    for text, value in list(product(texts, VALUES["yaml"]))[::step]:
        changed = text.replace(PLACE, value)
        found = attempt(lambda changed=changed: parse_loops(changed, "loops.yaml"))
        counts["refused" if found is None else "accepted"] += 1
        if isinstance(found, Loops):
            numbers = [x for each in found.coupled for of_joint in each.values() for x in of_joint]
            assert np.isfinite(numbers).all()
    print(f"loop files: {dict(counts)}")


CELLS = (
    "", " ", "nan", "NaN", "inf", "-inf", "1e400", "-1", "0", "1_0", "0x1", "1,5", "1;5", "\u0661", "x",
    "x" * 5000, "9" * 4301, "2024-01-01", "12:00", "\x1b[31m", "\x00", '"', '"a\nb"', "=1+1", "true",
    "1e-320", "1e308", "\ud800",
)  # fmt: skip
"""Texts of cells of a table."""

TABLES = {
    "measurements": (
        measurements_from_csv,
        "time,coordinate.pivot [deg],rate.pivot\nnoise,0.1,\nstart,0,0.1\n",
    ),
    "poses": (base_motion_from_csv, "time,x,roll\n"),
    "wind": (lambda path: wind_over_day(str(path), np.array([0.0, 0.5])), "time,speed\n"),
}


@SAMPLED
@pytest.mark.parametrize("kind", TABLES)
def test_cells_of_tables(tmp_path, kind, step):
    read, head = TABLES[kind]
    path, counts = tmp_path / "table.csv", Counter()
    rows = [head.splitlines()[0].split(","), *(line.split(",") for line in head.splitlines()[1:])]
    rows += [[f"{0.1 * k:.1f}", f"{k}", f"{0.01 * k}"][: len(rows[0])] for k in range(6)]
    places = [(i, j) for i in range(len(rows)) for j in range(len(rows[0]))]
    for (i, j), cell in list(product(places, CELLS))[::step]:
        changed = [list(row) for row in rows]
        changed[i][j] = cell
        text = "\n".join(",".join(row) for row in changed)
        for content in (text, text.replace("\n", "\r"), text.replace(",", "\t"), text + "\n,,,", text[:-3]):
            path.write_text(content, encoding="utf-8", errors="surrogatepass", newline="")
            found = attempt(lambda: read(path))
            counts["refused" if found is None else "accepted"] += 1
            if isinstance(found, np.ndarray):
                assert np.isfinite(found).all()
            elif isinstance(found, Measurements):
                assert all(np.isfinite(column).all() for column in found.columns.values())
    print(f"{kind}: {dict(counts)}")
    assert counts["refused"] > 0
