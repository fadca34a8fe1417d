"""Broken and hostile results, options and scenes that are too large, with what is to be said of each."""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from command_line import short_example
from hostile_files import MJCF, SEED, TEXTS, URDF, sparse

from crosscheck.report.page import RESULTS
from crosscheck.support.checksum import with_checksum
from crosscheck.support.results import digest
from newton_euler.model.trajectory import REQUIRED_ARRAYS, SHAPES, load_arrays

Prepare = Callable[[Path], None]

WORLD = "<worldbody>"


@dataclass(frozen=True)
class Refused:
    """A folder and a command line that is to be refused.

    Attributes:
        name: of the case.
        arguments: of the command line.
        message: what has to be in the line that refuses it; a pattern if there is an asterisk in it.
        prepare: makes the files, in a folder that has a copy of a run in `out`.
    """

    name: str
    arguments: tuple[str, ...]
    message: str
    prepare: Prepare

    def make(self, folder: Path) -> list[str]:
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in TEXTS.items():
            (folder / file).write_text(text)
        self.prepare(folder)
        return [*self.arguments]


CONTENT: dict[str, Any] = {
    "report": {"title": "", "verdict": "", "judged": {"text": ""}, "parts": []},
    "files": {},
    "sha256": "",
}
"""Results with nothing wrong."""


def damaged(text: str, dice: random.Random) -> Iterator[tuple[str, bytes]]:
    """Yield results that are none any more, whatever the text was."""
    content = json.loads(text)
    yield "empty", b""
    yield "of blanks", b" \n" * 100
    yield "null", b"null"
    yield "an empty object", b"{}"
    yield "a list", b"[]"
    yield "a number", b"7"
    yield "truncated", text.encode()[: dice.randrange(1, len(text) - 1)]
    yield "in UTF-16", text.encode("utf-16")
    yield "of noise", dice.randbytes(1000)
    yield "nested", b"[" * 100_000
    yield "nested inside", json.dumps(content).encode()[:-1] + b', "x": ' + b"[" * 5000 + b"]" * 5000 + b"}"
    yield "of nothing but null", json.dumps(dict.fromkeys(content)).encode()
    yield "of lists", json.dumps({key: [[]] for key in content}).encode()
    key = dice.choice([name for name in content if name not in ("words", "advice", "models", "notes")])
    yield (
        f"without {key}",
        json.dumps({name: value for name, value in content.items() if name != key}).encode(),
    )


def only(file: str, content: bytes) -> Prepare:
    def prepare(folder: Path) -> None:
        (folder / "results").mkdir()
        (folder / "results" / file).write_bytes(content)

    return prepare


def json_cases() -> Iterator[Refused]:
    """Results of every kind, which all have a report of one form, damaged in turn in every way."""
    files, dice = cycle(RESULTS), random.Random(SEED)
    for name, text in damaged(json.dumps(CONTENT), dice):
        file = next(files)
        yield Refused(f"{file} {name}", ("report", "results"), f"{file}: ", only(file, text))
    for name, make in PLACES.items():
        file = next(files)
        prepare = only(file, b"")

        def replaced(folder: Path, prepare=prepare, make=make, file=file) -> None:
            prepare(folder)
            (folder / "results" / file).unlink()
            make(folder / "results" / file)

        yield Refused(f"{file} {name}", ("report", "results"), "nothing of crosscheck's in results", replaced)


PLACES: dict[str, Callable[[Path], None]] = {
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a folder": Path.mkdir,
    "a link to nothing": lambda path: path.symlink_to("nowhere"),
    "a link to itself": lambda path: path.symlink_to(path.name),
}
"""Paths that are no regular files."""


def baseline_cases() -> Iterator[Refused]:
    arguments = ("regress", "pendulum", "--baseline", "base.json", "--output", "moved")
    for name, make in PLACES.items():
        message = (
            "base.json: cannot be read" if name.startswith("a link") else "base.json: not a regular file"
        )
        yield Refused(
            f"baseline {name}", arguments, message, lambda folder, make=make: make(folder / "base.json")
        )
    message = "base.json: 20.000001 MB, at most 20; to allow it: --set result_size=21"
    yield Refused("baseline too large", arguments, message, sparse("base.json", 20_000_001))
    stored = Path(__file__).parents[2] / "crosscheck" / "regress" / "baselines" / "pendulum.json"
    for name, text in damaged(stored.read_text(), random.Random(SEED)):
        yield Refused(
            f"baseline {name}",
            arguments,
            "base.json: ",
            lambda folder, text=text: (folder / "base.json").write_bytes(text) and None,
        )


def rewritten(run: Path, change: Callable[[dict[str, Any]], dict[str, Any]], vouched: bool = True) -> Prepare:
    """A run whose arrays are changed, and whose summary says that they are its own."""

    def prepare(folder: Path) -> None:
        shutil.copytree(run, folder / "out")
        path = folder / "out" / "newton_euler.npz"
        np.savez(path, **change(load_arrays(path)))
        if vouched:
            vouch(folder / "out", path)

    return prepare


def vouch(out: Path, path: Path) -> None:
    summary = json.loads((out / "summary.json").read_text())
    summary["files"][path.name] = digest(path)
    (out / "summary.json").write_text(json.dumps(with_checksum(summary)))


def array_cases(run: Path) -> Iterator[Refused]:
    """Arrays of other types, shapes and values."""

    def case(name: str, message: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Refused:
        message = f"newton_euler.npz: holds no trajectory: .*{re.escape(message)}"
        return Refused(name, ("report", "out"), message, rewritten(run, change))

    for name, dimensions in SHAPES.items():
        numbers = not name.endswith("_names")
        yield case(
            f"{name} of one more dimension",
            f"{name} is an array of ",
            lambda x, name=name: x | {name: x[name][None]},
        )
        yield case(
            f"{name} of whole numbers",
            f"{name} is an array of int64",
            lambda x, name=name: x | {name: np.zeros(x[name].shape, int)},
        )
        yield case(
            f"{name} of objects",
            "Object arrays cannot be loaded",
            lambda x, name=name: x | {name: x[name].astype(object)},
        )
        yield case(
            f"{name} a number", f"{name} is an array of ", lambda x, name=name: x | {name: np.float64(1.0)}
        )
        if len(dimensions) > 1 or not numbers:
            yield case(
                f"{name} one row more",
                "has shape ",
                lambda x, name=name: x | {name: np.concatenate([x[name], x[name][:1]])},
            )
        if numbers:
            bad = lambda x, name=name: x | {name: np.full_like(x[name], np.nan)}  # noqa: E731
            yield case(f"{name} of NaN", f"{name} is not finite", bad)
        if name in REQUIRED_ARRAYS:
            yield case(
                f"no {name}",
                f"no array {name!r}",
                lambda x, name=name: {k: v for k, v in x.items() if k != name},
            )
    for name, other in (("joint_angle", "angle_names"), ("angle_names", "joint_angle")):
        yield case(
            f"{name} without {other}",
            "one of joint_angle and angle_names without the other",
            lambda x, other=other: {k: v for k, v in x.items() if k != other},
        )
    for label in ("", "moon", "motor.", "motor.-1", "motor.\u0661", "motor.x"):
        yield case(
            f"an angle of {label!a}",
            "no coordinate of a joint",
            lambda x, label=label: x | {"angle_names": np.array([label])},
        )
    yield case("another array", "unknown array 'more'", lambda x: x | {"more": np.zeros(3)})
    yield case(
        "time backwards", "no bodies, or no times that increase", lambda x: x | {"time": x["time"][::-1]}
    )
    yield case(
        "of no time",
        "no bodies, or no times that increase",
        lambda x: {k: v if k.endswith("_names") else v[:0] for k, v in x.items()},
    )


def archive_cases(run: Path) -> Iterator[Refused]:
    """Archives that are truncated, exchanged, or unpack to gigabytes."""

    def case(name: str, message: str, change: Callable[[Path], None], vouched: bool = True) -> Refused:
        def prepare(folder: Path) -> None:
            shutil.copytree(run, folder / "out")
            path = folder / "out" / "newton_euler.npz"
            change(path)
            if vouched:
                vouch(folder / "out", path)

        return Refused(name, ("report", "out"), message, prepare)

    dice = random.Random(SEED)
    for k in range(6):
        cut = lambda path, k=k: path.write_bytes(path.read_bytes()[: k * path.stat().st_size // 6])  # noqa: E731
        yield case(f"archive truncated {k}", "newton_euler.npz: holds no trajectory", cut)
    for k in range(6):
        yield case(
            f"archive damaged {k}", "newton_euler.npz: is not the file", flip(dice.random()), vouched=False
        )
    other = lambda path: shutil.copy(path.with_name("pinocchio.npz"), path)  # noqa: E731
    yield case(
        "archives exchanged", "newton_euler.npz: is not the file that summary.json", other, vouched=False
    )
    yield case("archive of noise", "holds no trajectory", lambda path: path.write_bytes(dice.randbytes(5000)))
    yield case("archive that promises more", "holds no trajectory", bomb((10**6, 10**6, 3), b"\0" * 100))
    yield case("archive of 216 MB of zeros", "MB, at most 200", bomb((100, 90_000, 3), b"\0" * 216_000_000))
    yield case("archive with less than it says", "holds no trajectory", bomb((6, 4, 3), b"\0" * 100))
    yield case("archive of negative shape", "holds no trajectory", bomb((-6, 4, 3), b"\0" * 100))

    recording = lambda path: path.with_name("scene.rrd").write_bytes(b"RRF2")  # noqa: E731
    yield case("recording of another run", "scene.rrd: is not the file", recording)


def flip(share: float) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[int(share * len(content))] ^= 1
        path.write_bytes(content)

    return change


def bomb(shape: tuple[int, ...], data: bytes) -> Callable[[Path], None]:
    """An archive whose position is of a shape, and has these bytes."""

    def change(path: Path) -> None:
        header = io.BytesIO()
        fields = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(header, fields)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("position.npy", header.getvalue() + data)

    return change


def nothing(folder: Path) -> None:
    """No file but those that are always there."""


def written(file: str, content: object) -> Prepare:
    def prepare(folder: Path) -> None:
        (folder / file).write_text(content if isinstance(content, str) else json.dumps(content))

    return prepare


def size_cases() -> Iterator[Refused]:
    """Yield models that are too large, with the limit that says so; see `test_size` for those of scenes."""
    function = {"kind": "polynomial", "coefficients": [0, 1e6]}
    content = short_example() | {"control": [], "motions": [{"joint": "motor", "function": function}]}
    for command in (("run", "large.json", "--output", "new"), ("convert", "large.json", "new.yaml")):
        message = "large.json: file: .*--set cycles=7958"
        prepare = written("large.json", content)
        yield Refused(f"a motion of 1e6 rad/s in a loop, {command[0]}", command, message, prepare)
    motor, connect = '<motor joint="motor"/>', '<connect site1="tip" site2="end"/>'
    plain = MJCF.replace('<mesh name="wedge" file="wedge.obj"/>', "")
    plain = plain.replace('<geom type="mesh" mesh="wedge"/>', '<geom size="0.1"/>')
    for name, old, new, message in (
        ("100 000 actuators", "<actuator>", "<actuator>" + motor * 100_000, "--set forces=100001"),
        ("300 equalities", "<equality>", "<equality>" + connect * 299, "--set closures=300"),
        ("wind", WORLD, f'<option wind="1e308 0 0" density="1e308"/>{WORLD}', "option: wind is"),
        ("a fluid", WORLD, f'<option density="1e100"/>{WORLD}', "option: density is 1e+100"),
        ("a thick fluid", WORLD, f'<option viscosity="1e300"/>{WORLD}', "option: viscosity is 1e+300"),
    ):
        prepare = written("large.xml", plain.replace(old, new))
        yield Refused(f"MJCF of {name}", ("run", "large.xml"), message, prepare)
    elbow = 'name="elbow" type="continuous">'
    mimics = URDF.replace(elbow, elbow + '<mimic joint="motor"/>' * 100_000)
    yield Refused(
        "100 000 mimics", ("run", "large.urdf"), "--set closures=100000", written("large.urdf", mimics)
    )
    pairs, kinds = ", ".join(["[tip, end]"] * 300), ", ".join(["3d"] * 300)
    loops = f"closed_loop: [{pairs}]\ntype: [{kinds}]\nname_mot: [motor]\njoint_name: []\njoint_type: []\n"
    arguments = ("run", "robot.urdf", "--set", "loops=large.yaml")
    yield Refused("300 loops", arguments, "--set closures=300", written("large.yaml", loops))
