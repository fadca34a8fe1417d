"""The study that runs public model files and writes their table."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from crosscheck.studies.models import (
    TABLE_BEGIN,
    TABLE_END,
    ModelResult,
    Repository,
    main,
    read_list,
    table,
    write,
)
from crosscheck.support.errors import CrosscheckError

LIST = """models:
  - repository: some/robots
    options: {duration: 0.05}
    files:
      - file: arm.xml
      - file: broken.xml
        why: it is no XML
      - file: other.urdf
        options: {base: free}
        why: one of the engines | is wrong
        ours: true
      - file: floor.xml
      - file: not/run/yet.xml
"""

FLOOR = """<mujoco><worldbody><geom type="plane" size="9 9 1"/>
<body pos="0 0 0.09"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>"""

ARM = """<mujoco><worldbody><body><joint name="j" axis="0 1 0" range="-90 90"/>
<geom size="0.1" pos="0.3 0 0"/></body></worldbody></mujoco>"""


def test_the_table_has_counts_and_reasons(tmp_path: Path) -> None:
    (tmp_path / "list.yaml").write_text(LIST)
    repositories = read_list(tmp_path / "list.yaml", "models", Repository)
    fates = {"exactly": 5, "inactive": 2, "left out": 3}
    found = {
        "some/robots/arm.xml": ModelResult(
            verdict="AGREE",
            line="AGREE: all",
            fates=fates,
            covered="4 of 5",
            lacks="3 elements are left out",
            processor_time=3.2,
        ),
        "some/robots/broken.xml": ModelResult(verdict="refused", line="error", fates={}, processor_time=1.0),
        "some/robots/floor.xml": ModelResult(
            verdict="AGREE ON A REDUCED MODEL",
            line="",
            reason="without contact " + 300 * "x",
            first="contacts",
            processor_time=4.0,
        ),
        "some/robots/other.urdf": ModelResult(
            verdict="DISAGREE", line="DISAGREE: part", reason="part", fates=fates, processor_time=2.0
        ),
    }
    lines = list(table(repositories, found))
    counts = " ".join(lines[: lines.index("")])
    assert counts.startswith(
        "4 models of 1 repositories: 1 AGREE, 1 AGREE ON A REDUCED MODEL, 1 DISAGREE, 1 refused."
    )
    assert (
        "is the reason in 1 of them. 10 elements of the files are imported exactly, 4 are inactive, and 6"
        in (counts)
    )
    assert "| contacts | 1 |" in lines
    assert lines[-5:-1] == [
        "| arm | AGREE |  | 4 of 5 | 3 elements are left out | 3 | duration=0.05 | some/robots: arm.xml |",
        "| broken | refused | it is no XML |  |  | 1 | duration=0.05 | some/robots: broken.xml |",
        f"| floor | AGREE ON A REDUCED MODEL | without contact {220 * 'x'} ..."
        " |  |  | 4 | duration=0.05 | some/robots: floor.xml |",
        "| other | DISAGREE | one of the engines \\| is wrong |  |  | 2 | duration=0.05, base=free"
        " | some/robots: other.urdf |",
    ]
    target = tmp_path / "models.md"
    target.write_text(f"before\n{TABLE_BEGIN}\nold\n{TABLE_END}\nafter\n")
    write(target, ["new", "lines"])
    assert target.read_text() == f"before\n{TABLE_BEGIN}\nnew\nlines\n{TABLE_END}\nafter\n"
    target.write_text("no marks")
    with pytest.raises(CrosscheckError, match="has no lines"):
        write(target, [])


@pytest.mark.slow
def test_files_are_run_each_by_itself(tmp_path: Path) -> None:
    files = LIST.split("      - file: other")[0]
    (tmp_path / "list.yaml").write_text(f"{files}      - file: floor.xml\n")
    robots = tmp_path / "some" / "robots"
    robots.mkdir(parents=True)
    (robots / "arm.xml").write_text(ARM)
    (robots / "broken.xml").write_text("<mujoco>")
    (robots / "floor.xml").write_text(FLOOR)
    (tmp_path / "models.md").write_text(f"{TABLE_BEGIN}\n{TABLE_END}\n")
    arguments = ["list.yaml", str(tmp_path), "--write", "models.md", "--output", "out"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done = CliRunner().invoke(main, arguments)
        assert done.exit_code == 0, done.output
        text = (tmp_path / "models.md").read_text()
        assert "| arm | AGREE |  | 3 of 3 | 2 elements are inactive |" in text
        assert "| broken | refused | it is no XML |" in text
        assert "| floor | AGREE ON A REDUCED MODEL | without contacts, which act from" in text
        assert "| contacts | 1 |" in text
        again = CliRunner().invoke(main, [*arguments, "--only", "broken"])
        assert "arm.xml" not in again.output
        assert "| arm | AGREE" in (tmp_path / "models.md").read_text()
