"""The judgement of a file's own run in every format: terminal, Markdown, JSON, page, notebook."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mjcf_models import LOOP
from pages import Page

import crosscheck
from crosscheck.report.own_run import headline
from crosscheck.report.page import PAGE, write_report
from crosscheck.report.render import markdown
from crosscheck.support.checksum import with_checksum
from crosscheck.support.errors import CrosscheckError


@pytest.fixture(scope="module")
def verdict(tmp_path_factory):
    """A linkage with a step of 5 ms and MuJoCo's default softness."""
    path = tmp_path_factory.mktemp("loop") / "loop.xml"
    path.write_text(LOOP.format(reach=0.4).replace('timestep="0.002"', 'timestep="0.005"'))
    return crosscheck.check(path, ["newton_euler", "mujoco"], duration=0.3)


@pytest.fixture
def without_views(monkeypatch):
    """Make pages without pictures of recordings."""

    def no_driver(*_):
        raise CrosscheckError("no Vulkan driver")

    monkeypatch.setattr("crosscheck.recording.screenshot.screenshots", no_driver)


@pytest.fixture
def folder(verdict, tmp_path, without_views):
    verdict.save(tmp_path)
    return tmp_path


def test_it_is_the_first_after_the_verdict(verdict):
    own = verdict.own_run
    first, *_ = verdict.report.summary
    assert first.lines[0] == f"your settings  {headline(own)}"
    assert first.verdict == own.band.verdict == "doubtful"
    text = str(verdict)
    assert text.index("AGREE") < text.index("your settings") < text.index("worst of")
    told = markdown(verdict.report)
    assert f"- **your settings  {headline(own)}**" in told
    assert told.index("your settings") < told.index("engines compared")
    html = verdict._repr_html_()
    assert f'<li class="doubtful"><b>your settings</b> {headline(own)}</li>' in html


def test_json_has_the_judgement_and_the_error_over_time(folder, verdict):
    found, own = json.loads((folder / "summary.json").read_text())["own_run"], verdict.own_run
    assert (found["band"], found["relative"]) == ("OFF", own.error.relative)
    assert found["causes"][0]["name"] == own.causes[0].name
    assert found["remedies"][0]["fragment"] == own.remedies[0].fragment
    curve = found["error_over_time"]
    assert curve["time"] == own.run.time.tolist()
    assert np.max(curve["position"]) == own.error.position
    assert np.max(curve["rotation"]) == own.error.rotation


def test_the_page_has_the_judgement_and_its_error_over_time(folder, verdict):
    write_report(folder, lambda _: None)
    page = Page(folder / PAGE)
    words = page.words
    assert words.index(verdict.crosscheck.verdict.partition(": ")[2]) < words.index(headline(verdict.own_run))
    assert verdict.own_run.settings in words
    text = (folder / PAGE).read_text()
    assert "<b>cause</b> " in text
    assert "<b>fix</b> " in text
    pictures = [caption for caption in page.images if "run with your settings" in caption]
    assert pictures == [
        "error of position, m: run with your settings, largest over the bodies",
        "error of orientation, rad: run with your settings, largest over the bodies",
    ]


@pytest.mark.slow
def test_the_page_has_the_error_of_a_log_over_time(tmp_path, without_views):
    path = tmp_path / "loop.xml"
    path.write_text(LOOP.format(reach=0.4))
    options = {"duration": 0.05, "excitation": "off"}
    run = crosscheck.check(path, ["newton_euler"], **options).trajectories["newton_euler"]
    logged = crosscheck.check(path, ["newton_euler"], runs={"mine": lambda state, times: run}, **options)
    logged.save(tmp_path / "out")
    write_report(tmp_path / "out", lambda _: None)
    assert [image for image in Page(tmp_path / "out" / PAGE).images if ": log " in image] == [
        "error of position, m: log mine, largest over the bodies",
        "error of orientation, rad: log mine, largest over the bodies",
    ]


def test_a_curve_with_a_missing_number_is_refused(folder):
    path = folder / "summary.json"
    content = json.loads(path.read_text())
    content["own_run"]["error_over_time"]["position"].pop()
    path.write_text(json.dumps(with_checksum(content)))
    with pytest.raises(CrosscheckError, match="not equally long"):
        write_report(folder, lambda _: None)
