"""Check an MJCF file before MuJoCo parses it, and compile it in a separate process with limits.

A file may be hostile: it can expand to millions of elements, refer to files outside of its folder, or crash
the compiler. `_Scan` therefore checks the XML text and all references to files first. `compile_file` then
runs MuJoCo's compiler with limits of time and memory, and checks the numbers of the compiled model.
`copy_model` copies or compiles a model in memory, and checks its numbers.

The limits are in the table of `newton_euler.limits`, such as "file_size"; users change them by `--set`.
`exceeded(name, value)` returns a message, or "" if the value is within the limit. `too_small(name)` returns
advice to raise a limit.
"""

from __future__ import annotations

import copy
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from mjcf.errors import MjcfError
from mjcf.reading.compile import compile_spec
from newton_euler.errors import quoted
from newton_euler.free_memory import free_memory
from newton_euler.limits import MB, exceeded, limit, size_in_bytes, too_small
from newton_euler.model import source_file
from newton_euler.model.source_file import MAX_MODEL_NUMBER, NON_FINITE_WORDS, read_xml, scan

MAX_WAIT_S = 300.0
"""Largest waiting time for the compiler in addition to its CPU time, s; the machine may be busy."""

MAX_COMPILE_S = 1_000_000
"""Largest limit of the compiler's CPU time that all operating systems accept, s."""

SECONDS_PER_ASSET_BYTE = 2e-7
"""CPU time that the compiler may use for each byte of the assets, s, in addition to the limit `compile_time`.

On an idle machine the compiler needs 0.4 s, including imports, and 0.04 s per MB of meshes. The bytes of the
XML add no allowance: 8.5 MB of vertices take 0.9 s, and 1.2 MB of geoms 1 s."""

MEMORY_ERROR_WORDS = ("MemoryError", "llocat", "bad_alloc")
"""Parts of error messages that mean a lack of memory."""

FULL_MEMORY_FRACTION = 0.5
"""Used fraction of the memory limit above which a crash is attributed to a lack of memory.

Models that need more memory have used 85 % at the crash; models that crash MuJoCo have used a few MB."""

READING_COPIES = 2
"""Largest number of copies of a compiled model that exist at a time during its import: one for the import,
one for the reference model."""

ACTUATED_READING_COPIES = 3
"""Largest number of copies for a model with actuators. A second reference model, with random controls,
verifies the actuators."""

UNKNOWN_ERROR = "unknown exception"
"""Message of MuJoCo for an error without a reason."""

UNNAMED = "MuJoCo Model"
"""Name that MuJoCo gives to a model without a name."""

FOLDER_ATTRIBUTES = ("meshdir", "texturedir", "assetdir")
"""Attributes of `<compiler>` with folders of assets."""

ASSET_ELEMENTS = ("mesh", "texture", "hfield", "skin", "flexcomp", "composite")
"""Elements with files that MuJoCo reads: attributes `file`, `fileright` and so on."""

# fmt: off
FREE_TEXT = frozenset((
    "name", "class", "childclass", "model", "prefix", "file", "content_type", "meshdir", "texturedir",
    "assetdir", "body", "body1", "body2", "joint", "joint1", "joint2", "jointinparent", "geom", "geom1",
    "geom2", "site", "site1", "site2", "refsite", "sidesite", "cranksite", "slidersite", "tendon",
    "tendon1", "tendon2", "actuator", "mesh", "material", "texture", "hfield", "flex", "skin", "key",
    "camera", "target", "parent", "objname", "reftype", "refname", "instance", "plugin", "data",
))
# fmt: on
"""Attributes with names and other text, in which the words `inf` and `nan` are not numbers."""

NAMED_PREFIXES = ("body", "jnt", "site", "eq", "tendon", "actuator", "key")
"""Prefixes of the model's arrays of elements with names."""

KEY_FIELDS = ("qpos", "qvel", "act", "ctrl")
"""Attributes of keyframes with one number for each coordinate, velocity, activation or control."""

CHECKED_PREFIXES = ("body", "jnt", "dof", "site", "eq", "tendon", "actuator", "key", "qpos")
"""Prefixes of the model's arrays that an imported scene depends on; their numbers are checked."""

CHECKED_OPTIONS = ("gravity", "wind", "magnetic", "density", "viscosity", "timestep")
"""Options of a model whose numbers are checked."""

ITERATION_OPTIONS = ("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations")
"""Options of a model with numbers of iterations; a time step can take forever if they are large."""

STATE_FIELDS = ("key_qpos", "key_qvel", "key_act", "key_ctrl")
"""Arrays of keyframes whose limit is `mjMAXVAL`: for larger values MuJoCo resets a run as diverged."""

UNCHECKED_SUFFIXES = ("solref", "solimp", "range", "user", "invweight0", "acc0", "M0", "length0")
"""Suffixes of arrays that no scene uses, or that MuJoCo computes from others."""


class SourceError(source_file.SourceError, MjcfError):
    """File that is not a usable model. The message has the file, the place in the file and the problem."""


KeySizes: TypeAlias = dict[int, dict[str, int]]
"""Number of values of each field of a keyframe, by number of the keyframe in the file. The import reports
keyframes that have fewer values than the compiled model."""


def compile_file(path: str, root: str | None = None) -> tuple[Any, KeySizes]:
    """Compile an MJCF file.

    Args:
        path: path of the file.
        root: folder that must contain all files that the file refers to. None means the file's own folder for
            included files, and the parent of this folder for meshes and textures.

    Returns:
        The `MjModel`, and the sizes of its keyframes in the file.

    Raises:
        SourceError: for a file that cannot be read, that is not MJCF, that refers to a file outside the root,
            or that MuJoCo refuses, with MuJoCo's reason.
    """
    checked_file = _Scan(path, root)
    checked_file.run()
    model = _compiled(path, checked_file.asset_bytes)
    _check_counts(path, model)
    # attached models may add keyframes; then the k-th keyframe of the file is not keyframe k of the model,
    # and the sizes are not used
    sizes = checked_file.keyframe_sizes if len(checked_file.keyframe_sizes) == model.nkey else []
    return model, dict(enumerate(sizes))


class XmlTexts(NamedTuple):
    """Texts of an MJCF file and of the files that it includes.

    Attributes:
        texts: the texts by real path, the top file first.
        included: real path of each included file, by that of the including file and the attribute `file`.
        find_asset: returns the path of an asset from its tag and its attribute `file`; None if it is missing.
    """

    texts: dict[str, str]
    included: dict[tuple[str, str], str]
    find_asset: Callable[[str, str], str | None]


def read_texts(path: str) -> XmlTexts:
    """Read and check an MJCF file and the files that it includes, but not its meshes and textures.

    A path that ends with `.urdf` may be a URDF, which MuJoCo reads too.

    Raises:
        SourceError: for a file that cannot be read, that is not MJCF, or that includes a file outside of its
            folder.
    """
    checked_file = _Scan(path, None, root_tag=None if path.lower().endswith(".urdf") else "mujoco")
    checked_file.scan_texts()
    return XmlTexts(checked_file.texts, checked_file.included, checked_file.find_asset)


def check_memory(where: str, model: Any) -> None:
    """Raise `SourceError` if the copies of a compiled model need more than the free memory.

    Args:
        where: path or name of the model, for the message.
        model: `MjModel`.
    """
    needed = (ACTUATED_READING_COPIES if model.nu else READING_COPIES) * model.nbuffer
    free = free_memory()
    if needed > free:
        shortage = f"reading needs {needed / MB:.0f} MB more, {free / MB:.0f} MB are free; use smaller meshes"
        size = model.nbuffer / MB
        raise SourceError(where, f"the compiled model has {size:.0f} MB, mostly meshes; {shortage}")


def copy_model(model: object) -> tuple[str, Any, KeySizes]:
    """Compile a copy of an `MjSpec`, or copy an `MjModel`, and check its numbers.

    Returns:
        A name for messages, the new `MjModel`, and the sizes of the keyframes of an `MjSpec`.

    Raises:
        SourceError: for other types, and for models that MuJoCo or a limit refuses.
    """
    import mujoco

    sizes: KeySizes = {}
    if isinstance(model, mujoco.MjSpec):
        for number, key in enumerate(model.keys):
            counts = {name: len(getattr(key, name)) for name in KEY_FIELDS}
            sizes[number] = {name: count for name, count in counts.items() if count}
        where = _describe("MjSpec", model.modelname)
        try:
            compiled_model = compile_spec(model.copy())
        except (ValueError, MemoryError, mujoco.FatalError) as error:
            raise SourceError(where, f"MuJoCo refuses it: {' '.join(str(error).split()):.500}") from error
    elif isinstance(model, mujoco.MjModel):
        where, compiled_model = _describe("MjModel", model_name(model)), copy.copy(model)
    else:
        needed = "a path of a file, a mujoco.MjSpec or a mujoco.MjModel"
        raise SourceError(quoted(model, 200), f"cannot be read; needed: {needed}")
    _check_numbers(where, compiled_model)
    _check_counts(where, compiled_model)
    return where, compiled_model, sizes


def _describe(kind: str, name: str) -> str:
    """Return the name of a model in messages: its kind, and its own name if it has one."""
    return kind if name in ("", UNNAMED) else f"{kind} {name!r:.100}"


def model_name(model: Any) -> str:
    """Return the name in the root element of the file of a compiled model."""
    # MuJoCo stores all names in one buffer, the name of the model first
    return str(bytes(model.names).split(b"\0", 1)[0].decode(errors="replace"))


def _compiled(path: str, asset_bytes: int) -> Any:
    """Compile a checked file in a separate process; return the `MjModel`, or raise `SourceError`."""
    import mujoco

    # limits of CPU time, s, and memory, bytes
    assets = min(asset_bytes, size_in_bytes("asset_size"))
    seconds = int(np.clip(limit("compile_time") + SECONDS_PER_ASSET_BYTE * assets, 1, MAX_COMPILE_S))
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "model.mjb"
        # run `compile.py` by its path, so that the process imports MuJoCo only
        script = Path(__file__).with_name("compile.py")
        memory = size_in_bytes("memory")
        limits = map(str, (seconds, memory))
        # -P keeps the script's folder out of the search path, so that its modules cannot hide others
        command = [sys.executable, "-P", str(script), str(Path(path).resolve()), str(result), *limits]
        try:
            process = subprocess.run(
                command,
                cwd=folder,
                # one thread, because buffers of BLAS threads count for the memory limit
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=MAX_WAIT_S + seconds,
            )
        except subprocess.TimeoutExpired as error:
            waited = f"MuJoCo has not compiled the file after {MAX_WAIT_S + seconds:.0f} s"
            raise SourceError(path, f"{waited}: a file cannot be read, or the machine is busy") from error
        # the reason of a failure: time, memory, a crash, or an error of the file
        error_lines = process.stderr.decode(errors="replace").strip().splitlines()
        reason = error_lines[-1] if error_lines else ""
        if process.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
            problem = f"MuJoCo needs more than {seconds} s to compile it; {too_small('compile_time')}"
            raise SourceError(path, problem)
        if any(word in reason for word in MEMORY_ERROR_WORDS):
            raise SourceError(path, _too_little(memory))
        # a crash; an unknown exception comes, for example, from an overflow of rows times columns
        if process.returncode < 0 or UNKNOWN_ERROR in reason:
            name = signal.Signals(-process.returncode).name if process.returncode < 0 else UNKNOWN_ERROR
            used = _peak_memory()
            if used > FULL_MEMORY_FRACTION * memory:
                raise SourceError(path, _too_little(memory))
            usage = f"it used {used / MB:.0f} MB of memory and may have {memory / MB:.0f}"
            raise SourceError(path, f"MuJoCo crashes on it ({name}), not for lack of memory: {usage}")
        if process.returncode or not result.exists():
            raise SourceError(path, f"MuJoCo refuses it: {reason:.500}")
        try:
            model = mujoco.MjModel.from_binary_path(str(result))
        except ValueError as error:
            raise SourceError(path, f"MuJoCo cannot load what it compiled: {error}") from error
    _check_numbers(path, model)
    return model


def _too_little(memory: int) -> str:
    """Return the message for a memory limit, in bytes, that is too small."""
    return f"MuJoCo needs more than {memory / MB:.0f} MB of memory to compile it; {too_small('memory')}"


def _peak_memory() -> float:
    """Return the largest memory, bytes, of any ended child process."""
    try:
        import resource
    except ImportError:  # without `resource`, processes have no limits
        return 0.0
    return 1024.0 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def _check_counts(path: str, model: Any) -> None:
    """Raise `SourceError` if a number of elements or iterations exceeds its limit."""
    # by name of the limit; `nactuator` is a name of MuJoCo 4, in which `nu` counts controls
    counts = {"bodies": model.nbody, "velocities": model.nv, "closures": model.neq, "forces": model.nactuator}
    for name, count in counts.items():
        if problem := exceeded(name, count):
            raise SourceError(path, problem)
    for name in ITERATION_OPTIONS:
        if problem := exceeded("iterations", getattr(model.opt, name)):
            raise SourceError(path, f"option: {name} is too large: {problem}")


@dataclass(frozen=True)
class _Reference:
    """Reference of an XML file to another file.

    Attributes:
        where: path of the XML file.
        line: line in the XML file; 0 if it is not known.
        element: tag of the element that refers to the file.
        target: path of the referenced file, as the XML file has it.
    """

    where: str
    line: int
    element: str
    target: str

    def refused(self, problem: str) -> SourceError:
        """Return the error for this reference, with its line, element and path."""
        line = f"line {self.line}: " if self.line else ""
        return SourceError(self.where, f"{line}{self.element} file {self.target!r:.200} {problem}")

    def within(self, root: str, folder: str) -> str:
        """Return the real path of the referenced file; raises `SourceError` for a path outside the root.

        Args:
            root: folder that must contain the file.
            folder: folder that the target is relative to.
        """
        path = os.path.realpath(os.path.join(folder, self.target))
        if os.path.commonpath((root, path)) != root:
            around = os.path.commonpath((root, path))  # smallest root that allows it
            raise self.refused(f"leads outside of {root!r}; if you trust the file: --set root={around}")
        if "\\" in self.target:
            raise self.refused("holds a backslash; needed: / between folders")
        return path


class _Scan:
    """Check of an MJCF file and of the files that it includes or refers to, without building a tree of XML.

    Attributes:
        asset_bytes: total size of all files other than XML that MuJoCo may read.
        keyframe_sizes: for each keyframe, the number of values by field ("qpos", "ctrl", ...).
        texts: texts of the XML files by real path, the top file first.
        included: real path of each included file, by that of the including file and the attribute `file`.
    """

    def __init__(self, path: str, root: str | None, root_tag: str | None = "mujoco") -> None:
        """Prepare the check of the file `path`.

        Args:
            path: path of the file.
            root: folder that must contain all files, or None.
            root_tag: required tag of the file's root element; None allows any tag.
        """
        self._top_file, self._root_tag = path, root_tag
        self.texts: dict[str, str] = {}
        self.included: dict[tuple[str, str], str] = {}
        self._home = os.path.dirname(os.path.realpath(path))
        # without a root, included files must be in the folder of the file; assets may also be in neighboring
        # folders, unless the parent folder is the root of the disk
        parent = os.path.dirname(self._home)
        parent = self._home if parent == os.path.dirname(parent) else parent
        root = None if root is None else os.path.realpath(root)
        self._include_root, self._asset_root = root or self._home, root or parent
        # folders of all XML files, and the folders in `<compiler>` by attribute
        self._homes = [self._home]
        self._folders: dict[str, list[str]] = {name: [] for name in FOLDER_ATTRIBUTES}
        self._assets: list[_Reference] = []
        self.keyframe_sizes: list[dict[str, int]] = []
        self._files = self._bytes = 0  # number and total size of XML files
        self._sizes: dict[str, int] = {}  # bytes by path of asset

    @property
    def asset_bytes(self) -> int:
        """Total size of all assets, bytes."""
        return sum(self._sizes.values())

    def run(self) -> None:
        """Check all files; raises `SourceError` for the first problem."""
        self.scan_texts()
        # `<compiler>` may follow the assets, so that folders are known at the end
        for reference in self._assets:
            self._check_asset(reference)

    def scan_texts(self) -> None:
        """Check the XML files only; raises `SourceError` for the first problem."""
        self._scan_file(self._top_file, ())

    def _scan_file(self, path: str, including: tuple[str, ...]) -> None:
        """Check an XML file and the files that it includes.

        Args:
            path: path of the file.
            including: real paths of the files that include this file, the top file first.
        """
        real_path = os.path.realpath(path)
        if real_path in including:
            problem = f"{os.path.basename(path)!r} includes itself, through {including[-1]!r}"
            raise SourceError(self._top_file, problem)
        self._files += 1
        if problem := exceeded("files", self._files):
            raise SourceError(self._top_file, f"includes too many files: {problem}")
        included: list[_Reference] = []

        def check_element(tag: str, attributes: dict[str, str], line: int) -> None:
            """Check the attributes of an element, and store its references to files."""
            counts: dict[str, int] = {}
            if tag == "key":
                self.keyframe_sizes.append(counts)
            for name, value in attributes.items():
                if name not in FREE_TEXT and any(
                    token.lower().lstrip("+-") in NON_FINITE_WORDS for token in value.split()
                ):
                    raise SourceError(path, f"line {line}: <{tag}> has {name}={value!r:.100}, not finite")
                if tag == "compiler" and name in FOLDER_ATTRIBUTES:
                    _Reference(path, line, f"compiler {name}", value or ".").within(
                        self._asset_root, self._home
                    )
                    self._folders[name].append(value)
                if tag == "key" and name in KEY_FIELDS:
                    counts[name] = len(value.split())
                if name == "file" and tag in ("include", "model"):
                    included.append(_Reference(path, line, tag, value))
                elif name.startswith("file") and tag in ASSET_ELEMENTS:
                    self._assets.append(_Reference(path, line, tag, value))

        text = read_xml(path, SourceError, before=self._bytes)
        self._bytes += len(text)
        self.texts[real_path] = text
        # the root element of an included file can have any tag
        root_tag = None if including else self._root_tag
        scan(path, text, root_tag, check_element, SourceError)
        for reference in included:
            found = self._find_included(reference, os.path.dirname(real_path))
            self.included[real_path, reference.target] = os.path.realpath(found)
            self._scan_file(found, (*including, real_path))

    def _find_included(self, reference: _Reference, including_folder: str) -> str:
        """Return the path of an included file: relative to the top file, or to the including file."""
        root = self._include_root if reference.element == "include" else self._asset_root
        for home in (self._home, including_folder):
            path = reference.within(root, home)
            if os.path.exists(path):
                if os.path.dirname(path) not in self._homes:  # MuJoCo searches assets in all of these folders
                    self._homes.append(os.path.dirname(path))
                return os.path.join(home, reference.target)
        raise reference.refused("does not exist")

    def find_asset(self, element: str, target: str) -> str | None:
        """Return the path of an asset, or None if it does not exist; raises `SourceError` outside the root.

        Args:
            element: tag of the asset.
            target: path of the file, as the element has it.
        """
        paths = self._asset_paths(_Reference(self._top_file, 0, element, target))
        return next((path for path in paths if os.path.isfile(path)), None)

    def _asset_paths(self, reference: _Reference) -> list[str]:
        """Return paths of an asset in all folders that MuJoCo may search, with and without its folder."""
        name = "texturedir" if reference.element == "texture" else "meshdir"
        folders = [*self._folders[name], *self._folders["assetdir"]] or [""]
        # with the attribute `strippath`, MuJoCo removes the path
        stripped = replace(reference, target=os.path.basename(reference.target))
        return [
            file.within(self._asset_root, os.path.join(home, folder))
            for home in self._homes
            for folder in folders
            for file in (reference, stripped)
        ]

    def _check_asset(self, reference: _Reference) -> None:
        """Check that an asset exists, is a file, and is not too large, wherever MuJoCo may search it."""
        existing = [path for path in self._asset_paths(reference) if os.path.exists(path)]
        if not existing:
            raise reference.refused("does not exist")
        for path in existing:
            if not os.path.isfile(path):  # MuJoCo would wait for a pipe
                raise reference.refused("is not a regular file")
            self._sizes[path] = os.path.getsize(path)
            if problem := exceeded("asset_size", self._sizes[path] / MB):
                raise reference.refused(f"is too large: {problem}")


def _check_numbers(path: str, model: Any) -> None:
    """Raise `SourceError` for the first number of a model that is not finite or too large.

    Args:
        path: path or name of the model, for the message.
        model: `MjModel`.
    """
    import mujoco

    for name in CHECKED_OPTIONS:
        option = getattr(model.opt, name)
        if not np.all(np.abs(option) <= MAX_MODEL_NUMBER):
            raise SourceError(path, f"option: {name} is {option}; needed: at most {MAX_MODEL_NUMBER:g}")
    if not model.opt.timestep > 0.0:
        raise SourceError(
            path, f"option: timestep is {model.opt.timestep:g}; needed: a positive number of seconds"
        )
    for prefix, field in _number_fields(model):
        values = getattr(model, field)
        most = mujoco.mjMAXVAL if field in STATE_FIELDS else MAX_MODEL_NUMBER
        bad = ~(np.abs(values) <= most)  # also NaN
        if np.any(bad):
            row = int(np.argwhere(bad)[0][0])
            name = getattr(model, prefix)(row).name if prefix in NAMED_PREFIXES else ""
            raise SourceError(
                path, f"{prefix} {name or row!r}: {field} is {values[bad][0]:g}; needed: at most {most:g}"
            )


def _number_fields(model: Any) -> list[tuple[str, str]]:
    """Return prefix and name of each array of the model with numbers of the file, sorted by prefix."""
    prefixes_and_names = []
    for field in dir(model):
        prefix = field.split("_")[0].removesuffix("0")  # `qpos0` has the prefix "qpos"
        if field in STATE_FIELDS or (prefix in CHECKED_PREFIXES and not field.endswith(UNCHECKED_SUFFIXES)):
            values = getattr(model, field)
            if isinstance(values, np.ndarray) and values.dtype.kind == "f":
                prefixes_and_names.append((prefix, field))
    return sorted(prefixes_and_names, key=lambda pair: CHECKED_PREFIXES.index(pair[0]))
