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


def own_file_advice(found: Found) -> Iterator[Advice]:
    """For an MJCF with equalities: how far they open in it as it is, and as it is made stiffer."""
    if not is_model(found.source) or is_urdf(found.source):
        return
    from mjcf.read import read
    from mjcf.reading.sag import sag
    from mjcf.reading.stiffer import CHANGES, stiffen, words

    start = read(found.source, found.options.get("key"), root=found.options.get("root")).start
    own = sag(start, start.model, found.scene.duration) if start.gaps() else ""
    if isinstance(own, str) or own.gap == 0.0:
        return
    solref, solimp = start.model.eq_solref[own.equality], start.model.eq_solimp[own.equality]
    text = (
        f"{start.equality(own.equality)} of {Path(found.source).name}, run by MuJoCo as it is, opens by "
        f"{own.gap:.1e} (m or rad): it gives way like a spring, of solref {words(solref)} and solimp "
        f"{words(solimp)}"
    )
    if own.gap <= WANTED:
        yield Advice("loop", f"{text}, which is stiff enough")
        return
    model, tried, gap = copy.copy(start.model), list[str](), own.gap
    for change in CHANGES:
        made = stiffen(model, change, gap, WANTED)
        opened = sag(start, model, found.scene.duration)
        if isinstance(opened, str):
            break
        gap = opened.gap
        tried.append(f"{gap:.1e} with {made}")
        if gap <= WANTED:
            break
    yield Advice("loop", f"{text}; changed step by step it opens by {', then '.join(tried)}")
