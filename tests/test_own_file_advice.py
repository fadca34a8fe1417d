"""Why a loop of a user's own file gaps: what is advised closes it in plain MuJoCo."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import mjcf.read
from crosscheck.advice import WANTED, Advice, Found
from crosscheck.advice.own_file import own_file_advice

LINKAGE = Path(__file__).parents[1] / "examples" / "linkage.xml"
DURATION = 0.5


def advice(path: Path, **options: str) -> list[Advice]:
    scene = mjcf.read.read(path, options.get("key"), duration=DURATION).scene
    return list(own_file_advice(Found(scene, str(path), [], {}, [], options)))


def opened(text: str) -> float:
    """m, of the file's connect in plain MuJoCo."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    gaps = []
    while data.time < DURATION - 0.5 * model.opt.timestep:
        mujoco.mj_step(model, data)
        gaps.append(np.max(np.abs(data.efc_pos[:3])))
    return float(np.max(gaps))


def test_the_gap_and_what_closes_it() -> None:
    (found,) = advice(LINKAGE, key="go")
    text = LINKAGE.read_text()
    first = re.search(r"as it is, opens by (\S+) .* of solref \"(.*?)\" and solimp", found.text)
    assert first
    # MuJoCo's defaults, which the file does not change; two digits are printed
    assert first[2] == "0.02 1"
    assert float(first[1]) == pytest.approx(opened(text), rel=0.05)
    solimp = re.search(r"with solimp \"(.*?)\"", found.text)
    last = re.search(r"then (\S+) with timestep (\S+) s and solref \"(.*?)\"$", found.text)
    assert solimp
    assert last
    assert "with integrator RK4" in found.text
    followed = text.replace('timestep="0.002"', f'timestep="{last[2]}" integrator="RK4"')
    followed = followed.replace("<connect", f'<connect solref="{last[3]}" solimp="{solimp[1]}"')
    assert opened(followed) < WANTED < float(first[1])
    assert opened(followed) == pytest.approx(float(last[1]), rel=0.05)


def test_what_is_stiff_enough_is_called_so(tmp_path: Path) -> None:
    (found,) = advice(LINKAGE, key="go")
    step = re.search(r"with timestep (\S+) s", found.text)
    assert step
    stiff = LINKAGE.read_text().replace('timestep="0.002"', f'timestep="{step[1]}" integrator="RK4"')
    solref = f"{2.0 * float(step[1]):g} 1"
    stiff = stiff.replace("<connect", f'<connect solref="{solref}" solimp="0.9999 0.9999 0.001 0.5 2"')
    (tmp_path / "stiff.xml").write_text(stiff)
    (found,) = advice(tmp_path / "stiff.xml", key="go")
    assert found.text.endswith("which is stiff enough")
    assert "then" not in found.text


def test_nothing_is_said_of_what_has_no_equalities(tmp_path: Path) -> None:
    text = re.sub(r"<equality>.*</equality>", "", LINKAGE.read_text(), flags=re.DOTALL)
    (tmp_path / "open.xml").write_text(text)
    assert advice(tmp_path / "open.xml", key="go") == []
    scene = mjcf.read.read(tmp_path / "open.xml").scene
    assert list(own_file_advice(Found(scene, "tracker", [], {}, []))) == []
