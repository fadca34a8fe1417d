"""Optional packages that are not installed: one line says which, and the command that installs them."""

from __future__ import annotations

import json
import pickle
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

from newton_euler.errors import DISTRIBUTION, MissingPackageError
from newton_euler.optional_packages import optional_package

ROOT = Path(__file__).parents[3]

CONTENT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

OPTIONAL = ["pandas", "polars", "pvlib", "dask", "distributed", "SALib", "xarray", "zarr", "control"]
"""Import names of all packages that the product uses and the base distribution does not install."""

BLOCKED = f"""
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {OPTIONAL}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocker())
"""


def base(folder, *arguments):
    """Run a command line in a process where no optional package can be imported."""
    code = f"{BLOCKED}\nfrom crosscheck.cli import main\nsys.exit(main({list(map(str, arguments))}))"
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)


SUN = ("sun", "--latitude", "10", "--date", "2026-03-21")
SWEEP = ("sweep", "pendulum", "--vary", "dumbbell.mass=normal(1, 0.1)", "--runs", "4")


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (SUN, "sun"),
        (("year", "--latitude", "10", "--year", "2026"), "sun"),
        (("year", "--weather", "none.csv"), "sun"),
        (("run", "tracker_sun_day"), "sun"),
        (("regress", "tracker_sun_day"), "sun"),
        ((*SWEEP, "--keep", "peak:reaction_force"), "sweep"),
    ],
)
def test_a_command_without_its_packages_says_what_to_install(tmp_path, arguments, extra):
    done = base(tmp_path, *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert f"'{DISTRIBUTION}[{extra}]'" in line
    assert list(tmp_path.iterdir()) == []


def test_an_update_of_the_library_leaves_out_no_scene(tmp_path):
    done = base(tmp_path, "regress", "--update", "reason")
    assert done.returncode == 2
    assert f"'{DISTRIBUTION}[sun]'" in done.stderr


def test_the_list_names_what_a_scene_needs(tmp_path):
    done = base(tmp_path, "list")
    assert (done.returncode, done.stderr) == (0, "")
    (line,) = [line for line in done.stdout.splitlines() if f"{DISTRIBUTION}[sun]" in line]
    assert line.startswith("tracker_sun_day: ")


@pytest.mark.parametrize("left_out", [False, True])
def test_the_library_is_compared_without_scenes_whose_packages_are_missing(
    capsys, tmp_path, monkeypatch, left_out
):
    """Two scenes stand for the library: the omission is printed and stored, and the others decide."""
    from command_line import run

    from crosscheck import library as scenes

    def missing():
        raise MissingPackageError("pandas", "sun")

    chosen = {"pendulum": scenes.SCENES["pendulum"]} | ({"tracker_sun_day": missing} if left_out else {})
    monkeypatch.setattr(scenes, "SCENES", chosen)
    for module in ("crosscheck.regress.run", "crosscheck.library"):
        monkeypatch.setattr(f"{module}.SCENES", chosen)
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "regress")
    assert status == 0
    content = json.loads((tmp_path / "output/regress/regress.json").read_text())
    assert list(content["left_out"]) == (["tracker_sun_day"] if left_out else [])
    assert (f"'{DISTRIBUTION}[sun]'" in out) == left_out
    assert ("tracker_sun_day" in (tmp_path / "output/regress/summary.md").read_text()) == left_out
    assert [scene["scene"] for scene in content["scenes"]] == ["pendulum"]


def test_the_distribution_has_one_name(tmp_path):
    assert CONTENT["name"] == DISTRIBUTION
    done = base(tmp_path, "--version")
    assert done.stdout.split()[-1] == version(DISTRIBUTION)


def test_the_error_names_the_package_and_survives_a_process():
    with pytest.raises(MissingPackageError) as caught:
        optional_package("no_such_package.part", "sweep")
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.package, again.extra) == ("no_such_package", "sweep")
    assert str(again) == str(caught.value)


def test_what_is_broken_in_an_installed_package_is_not_called_missing(tmp_path, monkeypatch):
    (tmp_path / "broken_package.py").write_text("raise ImportError('its library does not load')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match="its library does not load"):
        optional_package("broken_package", "sweep")


def test_every_extra_that_is_named_exists_and_holds_what_is_imported_for_it():
    names = {"SALib": "salib"}
    extras = {
        extra: {re.split(r"[\[><=]", each)[0].lower() for each in packages}
        for extra, packages in CONTENT["optional-dependencies"].items()
    }
    found = set()
    for package in ("newton_euler", "mjcf", "urdf", "crosscheck"):
        for source in (ROOT / package).rglob("*.py"):
            text = source.read_text()
            for module, extra in re.findall(r'optional_package\("([\w.]+)", ("\w+"|[A-Z]+)\)', text):
                found.add((module.split(".")[0], extra.strip('"').lower()))
    assert found, "no import of an optional package"
    for module, extra in found - {("polars", "tables")}:  # instead of pandas, where that is installed
        assert names.get(module, module) in extras[extra]


def test_no_optional_package_is_imported_but_by_the_helper():
    allowed = {"crosscheck/sweeps/execute.py", "crosscheck/sweeps/store.py"}  # parts of what it has imported
    pattern = re.compile(rf"^ *(?:import|from) ({'|'.join(OPTIONAL)})\b", re.MULTILINE)
    for package in ("newton_euler", "mjcf", "urdf", "crosscheck"):
        for source in (ROOT / package).rglob("*.py"):
            checked = re.sub(r"^if TYPE_CHECKING:\n(?:    .*\n)+", "", source.read_text(), flags=re.MULTILINE)
            name = str(source.relative_to(ROOT))
            assert name in allowed or not pattern.search(checked), name
