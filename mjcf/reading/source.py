"""Compile an MJCF file in a separate process with limits, and check the numbers of the compiled model.

A file may be hostile: it can expand to millions of elements, refer to files outside of its folder, or crash
the compiler. `compile_file` therefore checks the XML text and all references to files first, see `XmlScan`.
It then runs MuJoCo's compiler with limits of time and memory. `copy_model` copies or compiles a model in
memory, and checks its numbers.

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
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from mjcf.reading.compile import compile_spec
from mjcf.reading.xml_scan import KEY_FIELDS, SourceError, XmlScan
from newton_euler.errors import quoted
from newton_euler.free_memory import free_memory
from newton_euler.limits import MB, exceeded, limit, size_in_bytes, too_small
from newton_euler.model.source_file import MAX_MODEL_NUMBER

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

NAMED_PREFIXES = ("body", "jnt", "site", "eq", "tendon", "actuator", "key")
"""Prefixes of the model's arrays of elements with names."""

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
    checked_file = XmlScan(path, root)
    checked_file.run()
    model = _compiled(path, checked_file.asset_bytes)
    _check_counts(path, model)
    # attached models may add keyframes; then the k-th keyframe of the file is not keyframe k of the model,
    # and the sizes are not used
    sizes = checked_file.keyframe_sizes if len(checked_file.keyframe_sizes) == model.nkey else []
    return model, dict(enumerate(sizes))


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
