"""An MJCF file, checked before any parser expands it, and compiled by MuJoCo."""

from __future__ import annotations

import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from mjcf.errors import MjcfError

MAXIMUM_BYTES = 10_000_000
"""Of one XML file."""

MAXIMUM_DEPTH = 400
"""Of nested elements; recursive parsers run out of stack somewhere above."""

MAXIMUM_FILES = 100
"""That may be included."""

LARGEST = 1e15
"""Of any number of a model, so that squares and triple products stay finite and keep digits."""

WALL_TIME = 60.0
"""s, for a compiler that waits for something; its processor time is limited in `mjcf.reading.compile`."""

ASSETS = ("mesh", "texture", "hfield", "skin", "model", "flexcomp", "composite")
"""Elements whose `file` is read by MuJoCo."""

NAMED = ("body", "jnt", "site", "eq", "tendon", "actuator", "key")
"""Prefixes of elements that have names."""

MAXIMUM_VELOCITIES = 300
"""Degrees of freedom without loops; comparisons at random states are dense."""

CHECKED = ("body", "jnt", "dof", "site", "eq", "tendon", "actuator", "key", "qpos")
"""Prefixes of what a scene is made of."""


class SourceError(MjcfError):
    """A file that is no usable model: names the file and what is wrong where."""

    def __init__(self, path: str, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


def compiled(path: str, root: str | None = None) -> Any:
    """The `MjModel` of an MJCF file.

    Args:
        path: of the file.
        root: folder that everything it refers to has to be in. If None, what it includes has to be in its
            own folder, and meshes and textures in that or in one beside it.

    Raises:
        SourceError: for a file that cannot be read, that is no MJCF, that reaches outside, or that MuJoCo
            refuses, with MuJoCo's reason.
    """
    _Scan(Path(path), root).run()
    import mujoco

    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "model.mjb"
        # by its path, without the packages around it: nothing but MuJoCo has to be imported
        script = Path(__file__).with_name("compile.py")
        command = [sys.executable, "-P", str(script), str(Path(path).resolve()), str(result)]
        try:
            done = subprocess.run(
                command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=WALL_TIME
            )
        except subprocess.TimeoutExpired as error:
            raise SourceError(path, "MuJoCo does not finish compiling it") from error
        reason = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [""]
        if done.returncode < 0 or "MemoryError" in reason[0] or "llocate" in reason[0]:
            raise SourceError(path, "MuJoCo needs too much time or memory to compile it")
        if done.returncode or not result.exists():
            raise SourceError(path, f"MuJoCo refuses it: {reason[0]:.500}")
        try:
            model = mujoco.MjModel.from_binary_path(str(result))
        except ValueError as error:
            raise SourceError(path, f"MuJoCo cannot load what it compiled: {error}") from error
    _check_numbers(path, model)
    if model.nv > MAXIMUM_VELOCITIES:
        raise SourceError(path, f"its joints have {model.nv} velocities, at most {MAXIMUM_VELOCITIES} here")
    return model


class _Scan:
    """One pass over a file and what it includes, without building anything."""

    def __init__(self, path: Path, root: str | None) -> None:
        self._top = path
        self._home = path.resolve().parent
        # models are often kept in a folder of their own beside those of their meshes
        around = self._home.parent
        around = self._home if around == Path(around.anchor) else around
        self._roots = (self._home, around) if root is None else (Path(root).resolve(),) * 2
        self._files = 0

    def run(self) -> None:
        self._read(self._top, ())

    def _read(self, path: Path, including: tuple[Path, ...]) -> None:
        where = str(path)
        if path.resolve() in including:
            raise SourceError(str(self._top), f"include of {path.name!r} by itself, through {where!r}")
        self._files += 1
        if self._files > MAXIMUM_FILES:
            raise SourceError(str(self._top), f"includes more than {MAXIMUM_FILES} files")
        for element, target, line in list(_references(where, read_bytes(where), not including)):
            self._check_path(where, element, target, line)
            if element == "include":
                inner = self._home / target
                if not inner.exists():
                    problem = f"line {line}: include of {target!r}, which does not exist"
                    raise SourceError(where, problem)
                self._read(inner, (*including, path.resolve()))

    def _check_path(self, where: str, element: str, target: str, line: int) -> None:
        root = self._roots[element != "include"]
        inside = "\\" not in target and (self._home / target).resolve().is_relative_to(root)
        if Path(target).is_absolute() or not inside:
            problem = f"line {line}: {element} file {target!r:.200} leads outside of {str(root)!r}"
            raise SourceError(where, f"{problem}; a model of several folders needs the option root")


def read_bytes(path: str) -> bytes:
    """The content of a regular file of reasonable size; raises `SourceError`."""
    try:
        status = Path(path).stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would keep its reader waiting
            raise SourceError(path, "not a regular file")
        if status.st_size > MAXIMUM_BYTES:
            raise SourceError(path, f"larger than {MAXIMUM_BYTES} bytes")
        return Path(path).read_bytes()
    except OSError as error:
        raise SourceError(path, f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise SourceError(repr(path), f"cannot be read: {error}") from error


def _references(path: str, content: bytes, top: bool) -> Iterator[tuple[str, str, int]]:
    """(element, file, line) of what an XML text refers to; raises `SourceError` unless it is well formed."""
    parser = expat.ParserCreate()
    found: list[tuple[str, str, int]] = []
    folders = dict.fromkeys(("meshdir", "texturedir", "assetdir"), "")
    depth = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        line = parser.CurrentLineNumber
        if depth == 0 and top and tag != "mujoco":
            raise SourceError(path, f"line {line}: root element is <{tag}>, not <mujoco>")
        depth += 1
        if depth > MAXIMUM_DEPTH:
            raise SourceError(path, f"line {line}: more than {MAXIMUM_DEPTH} nested elements")
        for name, value in attributes.items():
            if name in folders and tag == "compiler":
                folders[name] = value
                found.append((f"compiler {name}", value or ".", line))
            for token in value.split():
                if token.lower().lstrip("+-") in ("nan", "inf", "infinity"):
                    raise SourceError(path, f"line {line}: <{tag}> has {name}={value!r:.100}, not finite")
        if "file" in attributes and (tag == "include" or tag in ASSETS):
            own = folders.get({"texture": "texturedir"}.get(tag, "meshdir"), "") or folders["assetdir"]
            folder = "" if tag in ("include", "model") else own
            found.append((tag, str(Path(folder) / attributes["file"]), line))

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*_: object) -> None:
        raise SourceError(path, f"line {parser.CurrentLineNumber}: a document type declaration, refused")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        problem = expat.errors.messages[error.code]
        raise SourceError(path, f"not XML: line {error.lineno}: {problem}") from error
    yield from found


def _check_numbers(path: str, model: Any) -> None:
    """Raise `SourceError` for the first number of an element that is not finite or far too large."""
    for field in dir(model):
        prefix = field.split("_")[0].removesuffix("0")
        if prefix not in CHECKED or field.endswith(("solref", "solimp", "range", "user", "lengthrange")):
            continue
        values = np.asarray(getattr(model, field)) if not callable(getattr(model, field)) else np.zeros(0)
        if values.dtype.kind != "f" or not values.size:
            continue
        bad = ~(np.abs(values) <= LARGEST)
        if np.any(bad):
            row = int(np.argwhere(bad)[0][0])
            name = getattr(model, prefix)(row).name if prefix in NAMED else ""
            raise SourceError(path, f"{prefix} {name or row!r}: {field} is {values[bad][0]:g}")
