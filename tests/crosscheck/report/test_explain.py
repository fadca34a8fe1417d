"""Explanations: every kind that commands print has one, and no text is of a kind that does not exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_line import run

from crosscheck.compare.check import LEVELS, READING, REFERENCE
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.diagnosis import FAULTS
from crosscheck.compare.levels import compare, reading_checks
from crosscheck.compare.note import Note
from crosscheck.compare.outcome import ExitStatus, Outcome
from crosscheck.differences.difference import Quantity, Standing
from crosscheck.engines.registry import ENGINES
from crosscheck.loading.importers import Failure
from crosscheck.loading.load import load_scene
from crosscheck.own_run.allowed import ErrorKind
from crosscheck.own_run.errors import Band
from crosscheck.report.explain import TOPICS, explain, explanation_markdown, read_topic
from crosscheck.report.line_name import LineName
from crosscheck.report.run import notes, verdict_limits
from crosscheck.studies.conformance.check import Result
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.file_run import CauseName
from newton_euler.reading.import_report import FATES, Mistake

PLACE = re.compile("<!-- explanations: (.+) -->")
"""Place in a page that takes the explanations of a topic."""

KINDS = {
    "levels": {*LEVELS, REFERENCE},
    "faults": set(FAULTS),
    "verdicts": {each.value for each in Outcome},
    "statuses": {f"exit status {each}" for each in ExitStatus},
    "notes": {each.value for each in Note},
    "lines": {each.value for each in LineName},
    "accuracy": {each.value for each in Band},
    "own_run_causes": {each.value for each in CauseName},
    "errors": {each.value for each in ErrorKind},
    "fates": set(FATES),
    "findings": {each.value for each in Mistake},
    "standings": {each.value for each in Standing} | {"difference"},
    "differences": {each.value for each in Quantity},
    "importers": {each.value for each in Failure},
    "conformance": {each.value for each in Result},
}
"""Kinds by topic of the explanations; those of checks are found in a comparison."""

LEVEL_ROWS = [level.partition(" and ")[0] for level in LEVELS]
"""Names of levels in the table."""

EVERYTHING = """
<mujoco><option timestep="0.001"/>
  <worldbody>
    <body name="crank"><joint name="motor" axis="0 1 0" armature="0.01" damping="0.1" stiffness="1"
        frictionloss="0.1" range="-40 40" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01" contype="0" conaffinity="0"/>
      <body name="coupler" pos="0 0 0.1"><joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0.15" size="0.01" contype="0" conaffinity="0"/>
        <site name="a" pos="0.3 0 0.15"/></body></body>
    <body name="rocker" pos="0.3 0 0"><joint name="pivot" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.25" size="0.01" contype="0" conaffinity="0"/>
      <site name="b" pos="0 0 0.25"/></body>
  </worldbody>
  <equality><connect site1="a" site2="b"/></equality>
  <actuator><position joint="motor" kp="2" forcerange="-3 3"/></actuator>
</mujoco>
"""
"""Model that has each kind of check."""


def names(topic: str) -> list[str]:
    """The names that a topic explains."""
    return [each.name for each in read_topic(topic).explanations]


@pytest.mark.parametrize("topic", KINDS)
def test_each_kind_has_one_explanation(topic):
    assert sorted(names(topic)) == sorted(KINDS[topic])


def test_each_check_has_an_explanation_and_each_explained_check_exists(tmp_path):
    path = tmp_path / "everything.xml"
    path.write_text(EVERYTHING)
    options = {"duration": "0.02", "friction": "regularized", "limits": "compliant"}
    scene, report = load_scene(str(path), options, verified=False)
    engines = list(ENGINES.values())[:2]
    runs = {engine.name: engine.simulate(scene) for engine in engines}
    checks = [*reading_checks(engines, report), *compare(scene, engines, runs, states=1)]
    assert {check.level for check in checks} == set(LEVELS)
    explained = {each.name for check in checks for _, each in explain(check.quantity)}
    assert explained >= {*names("checks"), *names("reading_checks")}
    # a name of `reading_checks` is that of a check of this level
    of_reading = {each.name for c in checks if c.level == READING for _, each in explain(c.quantity)}
    assert of_reading >= set(names("reading_checks"))


def test_each_note_begins_with_words_that_are_explained(tmp_path):
    path = tmp_path / "everything.xml"
    path.write_text(EVERYTHING)
    scene, report = load_scene(str(path), {"duration": "0.02"}, verified=False)
    assert report is not None
    engines = list(ENGINES.values())[:1]
    # without the run of the file in its own engine, which has other lines
    found = crosscheck(scene, engines, lambda _: None, str(path), {}, report.unverified())
    assert found.mapping is not None
    lines = [*verdict_limits(found), *notes(found)]
    begin = {note for line in lines for note in Note if line.startswith(note)}
    assert {Note.INACTIVE, Note.FILE, Note.NOT_UNIQUE, Note.START} <= begin
    unknown = [line for line in lines if not line.startswith((*Note, *found.mapping.start))]
    assert unknown == []


def test_each_line_of_the_output_begins_with_a_name_that_is_explained(capsys, monkeypatch, tmp_path):
    """A limit acts, so that the output has the second judgement; rows of tables begin with other names."""
    path = tmp_path / "everything.xml"
    path.write_text(EVERYTHING.replace("-40 40", "-1 40"))
    monkeypatch.setenv("COLUMNS", "1000")  # no line is wrapped
    _, out, _ = run(capsys, "run", path, "--engines", "newton_euler,mujoco", "--output", tmp_path / "out")
    lines = [line.strip() for line in out.splitlines() if not line.startswith("          ") and line.strip()]
    title, verdict, *lines = lines
    assert title.startswith("everything")
    explain(verdict.partition(":")[0])
    engines = {"newton_euler", "mujoco"}
    names = {}
    for line in lines:
        first = line.split()[0]
        if first not in engines and not re.match(r"[\d.]+ s of motion", line):
            known = [name for name in (*LineName, *Note, *LEVELS, *LEVEL_ROWS) if line.startswith(name)]
            names[line] = max(known, key=len, default=None)
    assert [line for line, name in names.items() if name is None] == []
    assert {LineName.YOUR_SETTINGS, LineName.WITHOUT, LineName.CAUSE, LineName.MORE} <= set(names.values())
    for name in set(names.values()):
        assert explain(name)


@pytest.mark.parametrize("topic", TOPICS)
def test_names_are_found_whatever_their_spelling(topic):
    for each in read_topic(topic).explanations:
        assert each.meaning
        for spelling in (each.name, each.name.upper(), each.name.replace(" ", "_"), *each.also):
            assert each in [found for _, found in explain(spelling)]


@pytest.mark.parametrize(
    ("given", "name"),
    [("positions until 0.3744 s, m", "positions"), ("mass, rel", "mass"), ("Accelerations", LEVELS[4])],
)
def test_quantities_are_found_with_their_units(given, name):
    assert name in {each.name for _, each in explain(given)}


def test_an_unknown_name_gets_similar_ones():
    with pytest.raises(CrosscheckError, match="'soft constraints'") as caught:
        explain("soft constrants")
    assert "'drift'" not in str(caught.value)


def test_the_command_lists_all_names_and_explains_one(capsys):
    status, out, _ = run(capsys, "explain")
    assert status == 0
    assert all(name in out for topic in TOPICS for name in names(topic))
    status, out, _ = run(capsys, "explain", "soft", "constraints")
    assert status == 0
    assert out.startswith("soft constraints (")


@pytest.mark.parametrize("topic", TOPICS)
def test_pages_have_a_heading_or_a_row_with_an_anchor_for_each_name(topic):
    lines = "\n".join(explanation_markdown(topic)).split("\n")
    rows = [line for line in lines if line.startswith("| [")]
    cells = [re.match(r"\| \[(.+?)\]\(#(\S+)\)\{ #(\S+) \} \| \S", row) for row in rows]
    groups = {each.group for each in read_topic(topic).explanations} - {""}
    headings = [line.lstrip("# ") for line in lines if line.startswith("###")]
    assert [cell and cell[1] for cell in cells] + [each for each in headings if each not in groups] == names(
        topic
    )
    assert groups <= set(headings)
    assert all(cell and cell[2] == cell[3] for cell in cells)
    assert len({cell and cell[2] for cell in cells}) == len(rows)


def test_what_a_group_has_in_common_is_printed_for_each_name(capsys):
    _, out, _ = run(capsys, "explain", "condim")
    assert "Dimension of the contacts" in out
    assert "not simulated" in out


def test_each_topic_is_on_one_page():
    docs = Path(__file__).parents[3] / "docs"
    placed = [name for page in docs.glob("**/*.md") for name in PLACE.findall(page.read_text())]
    assert sorted(placed) == sorted(TOPICS)
