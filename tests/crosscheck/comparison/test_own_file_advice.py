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

LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"
DURATION = 0.5


def advice(path: Path, duration: float = DURATION, **options: str) -> list[Advice]:
    scene = mjcf.read.read(path, options.get("key"), duration=duration).scene
    return list(own_file_advice(Found(scene, str(path), [], {}, [], options)))


def opened(text: str, duration: float = DURATION) -> float:
    """m, the largest distance of the two sites of the file's connect in plain MuJoCo."""
    model = mujoco.MjModel.from_xml_string(text)
    data, after = mujoco.MjData(model), mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    first, second = model.eq_obj1id[0], model.eq_obj2id[0]
    gaps = []
    while data.time < duration - 0.5 * model.opt.timestep:
        mujoco.mj_step(model, data)
        after.qpos[:] = data.qpos
        mujoco.mj_kinematics(model, after)
        gaps.append(np.linalg.norm(after.site_xpos[first] - after.site_xpos[second]))
    return float(np.max(gaps))


def test_the_gap_and_what_closes_it() -> None:
    (found,) = advice(LINKAGE, key="go")
    text = LINKAGE.read_text()
    assert found.text.startswith("to open by at most 1e-06 (m or rad): equality 'loop' of linkage.xml")
    first = re.search(r"as it is, opens by (\S+): .* of solref \"(.*?)\" and solimp", found.text)
    assert first
    # MuJoCo's defaults, which the file does not change; two digits are printed
    assert first[2] == "0.02 1"
    assert float(first[1]) == pytest.approx(opened(text), rel=0.05)
    solref = re.search(r"with solref \"(.*?)\", the stiffest", found.text)
    solimp = re.search(r"with solimp \"(.*?)\"", found.text)
    last = re.search(r"then opens by (\S+) with integrator RK4; this is about the gap", found.text)
    assert solref
    assert solimp
    assert last
    followed = text.replace('timestep="0.002"', 'timestep="0.002" integrator="RK4"')
    followed = followed.replace("<connect", f'<connect solref="{solref[1]}" solimp="{solimp[1]}"')
    assert opened(followed) < WANTED < float(first[1])
    assert opened(followed) == pytest.approx(float(last[1]), rel=0.05)


def test_a_shorter_step_where_nothing_else_closes_it(tmp_path: Path) -> None:
    text = LINKAGE.read_text().replace('timestep="0.002"', 'timestep="0.004"')
    (tmp_path / "coarse.xml").write_text(text)
    (found,) = advice(tmp_path / "coarse.xml", key="go")
    solimp = re.search(r"with solimp \"(.*?)\"", found.text)
    last = re.search(r"then opens by (\S+) with timestep (\S+) s and solref \"(.*?)\"; this", found.text)
    assert solimp
    assert last
    assert "with integrator RK4" in found.text
    followed = text.replace('timestep="0.004"', f'timestep="{last[2]}" integrator="RK4"')
    followed = followed.replace("<connect", f'<connect solref="{last[3]}" solimp="{solimp[1]}"')
    assert opened(followed) < WANTED
    assert opened(followed) == pytest.approx(float(last[1]), rel=0.05)


def test_what_is_stiff_enough_is_called_so(tmp_path: Path) -> None:
    stiff = LINKAGE.read_text().replace('timestep="0.002"', 'timestep="0.002" integrator="RK4"')
    stiff = stiff.replace("<connect", '<connect solref="0.004 1" solimp="0.9999 0.9999 0.001 0.5 2"')
    (tmp_path / "stiff.xml").write_text(stiff)
    (found,) = advice(tmp_path / "stiff.xml", key="go")
    assert found.text.endswith("which is stiff enough")
    assert "then" not in found.text


def test_a_run_that_is_cut_says_so() -> None:
    """1,000 steps of the file are 2 s."""
    whole, cut = (advice(LINKAGE, duration, key="go") for duration in (2.0, 3.0))
    for (found,), words in ((whole, ":"), (cut, " in its first 2 s:")):
        gap = re.search(rf"as it is, opens by (\S+){words} ", found.text)
        assert gap
        # two digits are printed
        assert float(gap[1]) == pytest.approx(opened(LINKAGE.read_text(), 2.0), rel=0.05)


@pytest.mark.parametrize("torque_scale", [0.5, 1.0, 3.0])
def test_the_gap_of_a_weld_is_a_distance_or_an_angle(tmp_path: Path, torque_scale: float) -> None:
    """Sagging under gravity, turned by a constant torque, against poses after each step."""
    text = f"""
    <mujoco>
      <option gravity="3 4 0"/>
      <worldbody>
        <body name="held"><freejoint/><geom type="box" size="0.1 0.2 0.3" pos="0 0 0.2" mass="1"/></body>
        <body name="carrier" pos="2 0 0"><joint axis="0 1 0"/><geom size="0.1" mass="1"/></body>
      </worldbody>
      <equality><weld body1="held" body2="world" solref="0.1 1" torquescale="{torque_scale}"/></equality>
    </mujoco>"""
    (tmp_path / "held.xml").write_text(text)
    (found,) = advice(tmp_path / "held.xml")
    stated = re.search(r"as it is, opens by (\S+): ", found.text)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    gaps = []
    while data.time < DURATION - 0.5 * model.opt.timestep:
        mujoco.mj_step(model, data)
        angle = 2.0 * np.arctan2(np.linalg.norm(data.qpos[4:7]), abs(data.qpos[3]))
        gaps.append((np.linalg.norm(data.qpos[:3]), angle))
    distance, angle = np.max(gaps, axis=0)
    assert stated
    assert angle > 2.0 * distance  # so that an angle is stated
    assert float(stated[1]) == pytest.approx(angle, rel=0.05)  # two digits are printed


def test_nothing_is_said_of_what_has_no_equalities(tmp_path: Path) -> None:
    text = re.sub(r"<equality>.*</equality>", "", LINKAGE.read_text(), flags=re.DOTALL)
    (tmp_path / "open.xml").write_text(text)
    assert advice(tmp_path / "open.xml", key="go") == []
    scene = mjcf.read.read(tmp_path / "open.xml").scene
    assert list(own_file_advice(Found(scene, "tracker", [], {}, []))) == []
