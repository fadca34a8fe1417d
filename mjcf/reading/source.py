"""An MJCF file, checked before any parser expands it, and compiled by MuJoCo."""

from __future__ import annotations

import copy
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from mjcf.errors import MjcfError
from mjcf.reading.compile import compile_spec
from newton_euler.errors import quoted
from newton_euler.free_memory import free_memory
from newton_euler.limits import MB, exceeded, limit, size_in_bytes, too_small
from newton_euler.model import source_file
from newton_euler.model.source_file import LARGEST, NOT_FINITE, read_text, scan

WALL_TIME = 300.0
"""s of wall time, for a compiler that waits for something; others may use the processor, too."""

MAX_SECONDS = 1_000_000
"""s of processor time of the compiler, whatever `compile_time` is: operating systems can wait for as long."""

PER_ASSET_BYTE = 2e-7
"""s of processor time of the compiler for each byte of the assets, beside the limit `compile_time`.

On a quiet machine it takes 0.4 s, with its imports, and 0.04 s for a megabyte of meshes. What is small and
expands without end is given up after the former. The bytes of the XML add none: 8.5 MB of vertices take
0.9 s, 1.2 MB of geoms 1 s; a file of twice as many geoms is given up."""

OUT_OF_MEMORY = ("MemoryError", "llocat", "bad_alloc")
"""Words of errors about memory that is not to be had."""

FULL = 0.5
"""Share of its memory above which a process that crashed did so for lack of it: models that need more have
used 85 % of it by then, those that MuJoCo crashes on a few MB."""

COPIES, COPIES_WITH_ACTUATORS = 2, 4
"""Largest number of copies of a compiled model that its reading holds at a time, beside the model.

A model with actuators is read a second time, with all controls at random."""

UNKNOWN = "unknown exception"
"""Words of MuJoCo for an error of which it says nothing."""

UNNAMED = "MuJoCo Model"
"""MuJoCo's name for a model without one."""

FOLDERS = ("meshdir", "texturedir", "assetdir")
"""Attributes of compiler elements that say where assets are."""

ASSETS = ("mesh", "texture", "hfield", "skin", "flexcomp", "composite")
"""Elements whose `file`, or `fileright` and so on of a cube's faces, is read by MuJoCo."""

FREE_TEXT = frozenset(
    [
        "name",
        "class",
        "childclass",
        "model",
        "prefix",
        "file",
        "content_type",
        "meshdir",
        "texturedir",
        "assetdir",
        "body",
        "body1",
        "body2",
        "joint",
        "joint1",
        "joint2",
        "jointinparent",
        "geom",
        "geom1",
        "geom2",
        "site",
        "site1",
        "site2",
        "refsite",
        "sidesite",
        "cranksite",
        "slidersite",
        "tendon",
        "tendon1",
        "tendon2",
        "actuator",
        "mesh",
        "material",
        "texture",
        "hfield",
        "flex",
        "skin",
        "key",
        "camera",
        "target",
        "parent",
        "objname",
        "reftype",
        "refname",
        "instance",
        "plugin",
        "data",
    ]
)
"""Attributes that hold names and other text, in which `inf` and `nan` are words like others."""

NAMED = ("body", "jnt", "site", "eq", "tendon", "actuator", "key")
"""Prefixes of elements that have names."""

KEY_FIELDS = ("qpos", "qvel", "act", "ctrl")
"""Attributes of keyframes that hold a number for each coordinate, velocity, activation or control."""

CHECKED = ("body", "jnt", "dof", "site", "eq", "tendon", "actuator", "key", "qpos")
"""Prefixes of what a scene is made of."""

OPTIONS = ("gravity", "wind", "magnetic", "density", "viscosity", "timestep")
"""Of a model, that are numbers of any size."""

ITERATIONS = ("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations")
"""Of a model, that may keep a step of the file's own run from its end."""

STATES = ("key_qpos", "key_qvel", "key_act", "key_ctrl")
"""What MuJoCo takes for a run that diverges beyond its own limit, and then starts again from elsewhere."""

UNCHECKED = ("solref", "solimp", "range", "user", "invweight0", "acc0", "M0", "length0")
"""Ends of names of what no scene has, or of what MuJoCo works out of the others."""


class SourceError(source_file.SourceError, MjcfError):
    """A file that is no usable model: names the file and what is wrong where."""


KeySizes: TypeAlias = dict[int, dict[str, int]]
"""By number of a keyframe, how many numbers its fields have as they are written."""


def compiled(path: str, root: str | None = None) -> tuple[Any, KeySizes]:
    """The `MjModel` of an MJCF file, and the sizes of its keyframes as they are written.

    Args:
        path: of the file.
        root: folder that everything it refers to has to be in. If None, what it includes has to be in its
            own folder, and meshes and textures in that or in one beside it.

    Raises:
        SourceError: for a file that cannot be read, that is no MJCF, that reaches outside, or that MuJoCo
            refuses, with MuJoCo's reason.
    """
    scan = _Scan(path, root)
    scan.run()
    model = _compiled(path, scan.asset_bytes)
    _check_counts(path, model)
    keys = scan.keys if len(scan.keys) == model.nkey else []  # others come from models that are attached
    return model, dict(enumerate(keys))


def check_memory(where: str, model: Any) -> None:
    """Raise `SourceError` if the copies of a compiled model that a reading makes exceed the free memory."""
    size, free = model.nbuffer / MB, free_memory() / MB
    needed = (COPIES_WITH_ACTUATORS if model.nu else COPIES) * size
    if needed > free:
        lacks = f"its reading needs {needed:.0f} MB of memory more, {free:.0f} MB are free"
        raise SourceError(where, f"compiled it takes {size:.0f} MB, mostly of meshes; {lacks}")


def given(model: object) -> tuple[str, Any, KeySizes]:
    """A name for messages, the `MjModel`, and the sizes of keyframes, of an `MjSpec` or an `MjModel`.

    Neither is changed by what becomes of the result.

    Raises:
        SourceError: for anything else, and for models that MuJoCo or a limit refuses.
    """
    import mujoco

    sizes: KeySizes = {}
    if isinstance(model, mujoco.MjSpec):
        for number, key in enumerate(model.keys):
            counts = {name: len(getattr(key, name)) for name in KEY_FIELDS}
            sizes[number] = {name: count for name, count in counts.items() if count}
        where, made = _named("MjSpec", model.modelname), None
        try:
            made = compile_spec(model.copy())
        except (ValueError, MemoryError, mujoco.FatalError) as error:
            raise SourceError(where, f"MuJoCo refuses it: {' '.join(str(error).split()):.500}") from error
    elif isinstance(model, mujoco.MjModel):
        where, made = _named("MjModel", model_name(model)), copy.copy(model)
    else:
        needed = "a path of a file, a mujoco.MjSpec or a mujoco.MjModel"
        raise SourceError(quoted(model, 200), f"cannot be read; needed: {needed}")
    _check_numbers(where, made)
    _check_counts(where, made)
    return where, made, sizes


def _named(kind: str, name: str) -> str:
    return kind if name in ("", UNNAMED) else f"{kind} {name!r:.100}"


def model_name(model: Any) -> str:
    """The name in the root element of a compiled model."""
    return str(bytes(model.names).split(b"\0", 1)[0].decode(errors="replace"))


def _compiled(path: str, asset_bytes: int) -> Any:
    """The model of a file that may be compiled."""
    import mujoco

    assets = min(asset_bytes, size_in_bytes("asset_size"))
    seconds = int(np.clip(limit("compile_time") + PER_ASSET_BYTE * assets, 1, MAX_SECONDS))
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "model.mjb"
        # by its path, without the packages around it: nothing but MuJoCo has to be imported
        script = Path(__file__).with_name("compile.py")
        memory = size_in_bytes("memory")
        limits = map(str, (seconds, memory))
        command = [sys.executable, "-P", str(script), str(Path(path).resolve()), str(result), *limits]
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # buffers of BLAS threads count as memory
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=WALL_TIME + seconds,
            )
        except subprocess.TimeoutExpired as error:
            waited = f"MuJoCo has not compiled it after {WALL_TIME + seconds:.0f} s"
            raise SourceError(path, f"{waited}: it waits for a file, or the machine is busy") from error
        reason = (done.stderr.decode(errors="replace").strip().splitlines() or [""])[-1]
        if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
            problem = f"MuJoCo needs more than {seconds} s to compile it; {too_small('compile_time')}"
            raise SourceError(path, problem)
        if any(word in reason for word in OUT_OF_MEMORY):
            raise SourceError(path, _too_little(memory))
        if done.returncode < 0 or UNKNOWN in reason:  # as where a count of rows times columns overflows
            name = signal.Signals(-done.returncode).name if done.returncode < 0 else UNKNOWN
            used = _peak_memory()
            if used > FULL * memory:
                raise SourceError(path, _too_little(memory))
            room = f"it used {used / MB:.0f} MB of memory and may have {memory / MB:.0f}"
            raise SourceError(path, f"MuJoCo crashes on it ({name}), not for lack of memory: {room}")
        if done.returncode or not result.exists():
            raise SourceError(path, f"MuJoCo refuses it: {reason:.500}")
        try:
            model = mujoco.MjModel.from_binary_path(str(result))
        except ValueError as error:
            raise SourceError(path, f"MuJoCo cannot load what it compiled: {error}") from error
    _check_numbers(path, model)
    return model


def _too_little(memory: int) -> str:
    """Word that a memory in bytes is too small to compile a file, and what to do."""
    return f"MuJoCo needs more than {memory / MB:.0f} MB of memory to compile it; {too_small('memory')}"


def _peak_memory() -> float:
    """Find the largest memory in bytes of any process that this one has started and that has ended."""
    try:
        import resource
    except ImportError:  # not everywhere, and without it no process is limited either
        return 0.0
    return 1024.0 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def _check_counts(path: str, model: Any) -> None:
    """Raise `SourceError` for more of anything than a limit allows."""
    counts = {"bodies": model.nbody, "velocities": model.nv, "closures": model.neq, "forces": model.nactuator}
    for name, count in counts.items():
        if problem := exceeded(name, count):
            raise SourceError(path, problem)
    for name in ITERATIONS:
        if problem := exceeded("iterations", getattr(model.opt, name)):
            raise SourceError(path, f"option: {name} is too large: {problem}")


@dataclass(frozen=True)
class _Reference:
    """An element's word for where a file is.

    Attributes:
        where: path of the XML that says so.
        line: in that.
        element: its tag.
        target: the file.
    """

    where: str
    line: int
    element: str
    target: str

    def refused(self, problem: str) -> SourceError:
        text = f"line {self.line}: {self.element} file {self.target!r:.200} {problem}"
        return SourceError(self.where, text)

    def within(self, root: str, folder: str) -> str:
        """The path of the file, if it is relative to a folder; raises `SourceError` if it leaves the root."""
        path = os.path.realpath(os.path.join(folder, self.target))
        if os.path.commonpath((root, path)) != root:
            around = os.path.commonpath((os.path.realpath(folder), path))
            raise self.refused(f"leads outside of {root!r}; if you trust the file: --set root={around}")
        if "\\" in self.target:
            raise self.refused("holds a backslash; needed: / between folders")
        return path


class _Scan:
    """One pass over a file and what it includes, without building anything.

    Attributes:
        asset_bytes: of all files that MuJoCo may read and that are no XML.
        keys: how many numbers the fields of each keyframe have.
    """

    def __init__(self, path: str, root: str | None) -> None:
        self._top = path
        self._home = os.path.dirname(os.path.realpath(path))
        # models are often kept in a folder of their own beside those of their meshes
        around = os.path.dirname(self._home)
        around = self._home if around == os.path.dirname(around) else around
        top = None if root is None else os.path.realpath(root)
        self._inner, self._around = top or self._home, top or around
        self._homes = [self._home]
        self._folders: dict[str, list[str]] = {name: [] for name in FOLDERS}
        self._assets: list[_Reference] = []
        self.keys: list[dict[str, int]] = []
        self._files = self._bytes = 0
        self._sizes: dict[str, int] = {}

    @property
    def asset_bytes(self) -> int:
        return sum(self._sizes.values())

    def run(self) -> None:
        self._read(self._top, ())
        # compiler elements hold wherever in the file they stand, so folders are known at the end only
        for reference in self._assets:
            self._check_asset(reference)

    def _read(self, path: str, including: tuple[str, ...]) -> None:
        own = os.path.realpath(path)
        if own in including:
            problem = f"include of {os.path.basename(path)!r} by itself, through {including[-1]!r}"
            raise SourceError(self._top, problem)
        self._files += 1
        if problem := exceeded("files", self._files):
            raise SourceError(self._top, f"includes too much: {problem}")
        inner: list[_Reference] = []

        def begin(tag: str, attributes: dict[str, str], line: int) -> None:
            counts: dict[str, int] = {}
            if tag == "key":
                self.keys.append(counts)
            for name, value in attributes.items():
                if name not in FREE_TEXT and any(
                    token.lower().lstrip("+-") in NOT_FINITE for token in value.split()
                ):
                    raise SourceError(path, f"line {line}: <{tag}> has {name}={value!r:.100}, not finite")
                if tag == "compiler" and name in FOLDERS:
                    _Reference(path, line, f"compiler {name}", value or ".").within(self._around, self._home)
                    self._folders[name].append(value)
                if tag == "key" and name in KEY_FIELDS:
                    counts[name] = len(value.split())
                if name == "file" and tag in ("include", "model"):
                    inner.append(_Reference(path, line, tag, value))
                elif name.startswith("file") and tag in ASSETS:
                    self._assets.append(_Reference(path, line, tag, value))

        text = read_text(path, "file_size", SourceError, self._bytes)
        self._bytes += len(text)
        scan(path, text, None if including else "mujoco", begin, SourceError)
        for reference in inner:
            self._read(self._found(reference, os.path.dirname(own)), (*including, own))

    def _found(self, reference: _Reference, beside: str) -> str:
        """Path of an XML file: MuJoCo looks next to the first one, and next to the one that includes it."""
        root = self._inner if reference.element == "include" else self._around
        for home in (self._home, beside):
            path = reference.within(root, home)
            if os.path.exists(path):
                if os.path.dirname(path) not in self._homes:  # MuJoCo finds assets beside any of them
                    self._homes.append(os.path.dirname(path))
                return os.path.join(home, reference.target)
        raise reference.refused("does not exist")

    def _check_asset(self, reference: _Reference) -> None:
        """Look wherever MuJoCo may: by any of the compilers, with or without the path in the name."""
        name = "texturedir" if reference.element == "texture" else "meshdir"
        folders = [*self._folders[name], *self._folders["assetdir"]] or [""]
        stripped = replace(reference, target=os.path.basename(reference.target))
        paths = [
            file.within(self._around, os.path.join(home, folder))
            for home in self._homes
            for folder in folders
            for file in (reference, stripped)
        ]
        found = [path for path in paths if os.path.exists(path)]
        if not found:
            raise reference.refused("does not exist")
        for path in found:
            if not os.path.isfile(path):  # a pipe would keep MuJoCo waiting
                raise reference.refused("is not a regular file")
            self._sizes[path] = os.path.getsize(path)
            if problem := exceeded("asset_size", self._sizes[path] / MB):
                raise reference.refused(f"is too large: {problem}")


def _check_numbers(path: str, model: Any) -> None:
    """Raise `SourceError` for the first number of an element that is not finite or far too large."""
    import mujoco

    for name in OPTIONS:
        option = getattr(model.opt, name)
        if not np.all(np.abs(option) <= LARGEST):
            raise SourceError(path, f"option: {name} is {option}; needed: at most {LARGEST:g}")
    if not model.opt.timestep > 0.0:
        raise SourceError(
            path, f"option: timestep is {model.opt.timestep:g}; needed: a positive number of seconds"
        )
    for prefix, field in _number_fields(model):
        values = getattr(model, field)
        most = mujoco.mjMAXVAL if field in STATES else LARGEST
        bad = ~(np.abs(values) <= most)
        if np.any(bad):
            row = int(np.argwhere(bad)[0][0])
            name = getattr(model, prefix)(row).name if prefix in NAMED else ""
            raise SourceError(
                path, f"{prefix} {name or row!r}: {field} is {values[bad][0]:g}; needed: at most {most:g}"
            )


def _number_fields(model: Any) -> list[tuple[str, str]]:
    """Prefixes and names of the arrays of numbers that the file itself gives, in the order of `CHECKED`."""
    found = []
    for field in dir(model):
        prefix = field.split("_")[0].removesuffix("0")
        if field in STATES or (prefix in CHECKED and not field.endswith(UNCHECKED)):
            values = getattr(model, field)
            if isinstance(values, np.ndarray) and values.dtype.kind == "f":
                found.append((prefix, field))
    return sorted(found, key=lambda pair: CHECKED.index(pair[0]))
