"""Why the loops of an MJCF gap, and which solref, solimp and step close them: the file itself, run by MuJoCo.

An equality gives way like a damped spring. With the time constant t of solref and the impedance d of solimp
the gap under a steady load is t^2 (1 - d) / d of the acceleration that it holds back, but for a factor near 1
(MuJoCo's documentation, chapter Modeling, section Solver parameters). t is two steps at least, and steps err.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path

from crosscheck.advice.measured import WANTED, Advice, Found
from crosscheck.model_files.read import is_model, is_urdf
from newton_euler.verification.import_report import ImportReport

OTHER_ADVICE = (
    "this is about the gap of the file's own loops, advice on mujoco about the error of the motion, so that "
    "their settings may differ"
)


def own_file_advice(found: Found) -> Iterator[Advice]:
    """For an MJCF with equalities: how far they open in it as it is, and as it is made stiffer."""
    if not is_model(found.source) or is_urdf(found.source):
        return
    from mjcf.errors import heard_warnings
    from mjcf.reading.source import SourceError, compiled
    from mjcf.reading.start import Start
    from mjcf.sag import CHANGES, looked_at, sag, stiffen, words

    try:
        with heard_warnings():  # they are in the report of the reading
            model = compiled(found.source, found.options.get("root"))
            key, tolerance = found.options.get("key"), found.scene.redundancy_tolerance
            start = Start(found.source, model, key, ImportReport(), tolerance)
    except SourceError as error:
        yield Advice("loop", f"none on those of the file, which is no longer what was run: {error}")
        return
    own = sag(start, start.model, found.scene.duration) if start.gaps() else ""
    if isinstance(own, str) or own.gap == 0.0:
        return
    solref, solimp = start.model.eq_solref[own.equality], start.model.eq_solimp[own.equality]
    text = (
        f"to open by at most {WANTED:g} (m or rad): {start.equality(own.equality)} of "
        f"{Path(found.source).name}, run by MuJoCo as it is, opens by {own.gap:.1e}"
        f"{looked_at(start, found.scene.duration)}: it gives way like a spring, of solref "
        f"{words(solref)} and solimp {words(solimp)}"
    )
    if own.gap <= WANTED:
        yield Advice("loop", f"{text}, which is stiff enough")
        return
    model, tried, gap = copy.copy(start.model), list[str](), own.gap
    for change in CHANGES:
        made = stiffen(model, change, gap, WANTED)
        opened = sag(start, model, found.scene.duration)
        if isinstance(opened, str):
            tried.append(f"goes astray {opened} with {made}")
            break
        gap = opened.gap
        tried.append(f"opens by {gap:.1e} with {made}")
        if gap <= WANTED:
            break
    short = "" if gap <= WANTED else "; none of it is enough"
    yield Advice("loop", f"{text}; changed step by step it {', then '.join(tried)}{short}; {OTHER_ADVICE}")
