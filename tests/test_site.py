"""Site of the documentation: version, names, formulas, copied commands, folded tables, alternative texts."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import pytest
import yaml

from crosscheck.cli.help import TASKS

ROOT = Path(__file__).parents[1]

PAGES = sorted(str(page.relative_to(ROOT)) for page in (ROOT / "README.md", *ROOT.glob("docs/**/*.md")))

FENCE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)


TERMS = (
    "limitations",
    "Monte Carlo",
    "Jacobian",
    "license",
    "drift",
    "solref",
    "timestep",
    "closed loop",
    "inertia",
    "URDF",
    "Drake",
    "Exudyn",
    "SDF",
    "contact",
    "friction",
    "Baumgarte",
)
"""Terms that readers search for."""

GLOSSARY = ROOT / "docs" / "reference" / "glossary.md"

MATHML = "{http://www.w3.org/1998/Math/MathML}"


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    """The hooks of the site, which MkDocs loads by their path."""
    pytest.importorskip("latex2mathml")
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_formulas_become_mathml_with_their_number(hooks):
    source = r'<div class="arithmatex">\[J a &lt; \gamma \tag{3}\]</div>'
    made = ElementTree.fromstring(hooks.FORMULA.sub(hooks.mathematics, source))
    assert [child.tag for child in made] == [f"{MATHML}math", "span"]
    assert made[0].get("display") == "block"
    assert [each.text for each in made.iter(f"{MATHML}mo")] == ["<"]
    assert made[1].text == "(3)"


def test_formulas_in_a_sentence_stay_in_it(hooks):
    made = hooks.FORMULA.sub(hooks.mathematics, r'A <span class="arithmatex">\(q\)</span> b')
    assert made.startswith("A <math ")
    assert made.endswith("</math> b")


def test_bars_have_the_height_of_the_text_unless_they_are_to_stretch(hooks):
    source = r'<div class="arithmatex">\[\lvert x \rvert = \left\lvert \frac12 \right\rvert\]</div>'
    made = ElementTree.fromstring(hooks.FORMULA.sub(hooks.mathematics, source))
    bars = [each.get("stretchy") for each in made.iter(f"{MATHML}mo") if each.text == "|"]
    assert bars == ["false", "false", "true", "true"]


def test_formulas_that_cannot_be_converted_stop_the_build(hooks):
    source = r'<div class="arithmatex">\[\Big\lVert x \Big\rVert\]</div>'
    with pytest.raises(ValueError, match=r"\\Big"):
        hooks.FORMULA.sub(hooks.mathematics, source)


def test_functions_are_set_apart_from_their_argument(hooks):
    source = r'<div class="arithmatex">\[\cos x + \sin(x)\]</div>'
    made = ElementTree.fromstring(hooks.FORMULA.sub(hooks.mathematics, source))
    texts = [each.text or "" for each in made[0][0]]
    assert texts == ["cos", "", "x", "+", "sin", "(", "x", ")"]


def test_commands_are_copied_without_prompts_and_output(hooks):
    block = (
        '<div class="highlight"><pre><code><span class="gp">$ </span>crosscheck<span class="w"> </span>'
        "run &lt;a&gt;\n"
        '<span class="go">AGREE\nand more</span>\n<span class="gp">$ </span>ls\n</code></pre></div>'
    )
    copied = re.search('data-copy="([^"]*)"', hooks.CODE.sub(hooks.copied, block))
    assert copied is not None
    assert copied[1] == "crosscheck run &lt;a&gt;\nls"


def test_blocks_without_prompts_are_copied_as_they_are(hooks):
    block = '<div class="highlight"><pre><code>a = 1</code></pre></div>'
    assert hooks.CODE.sub(hooks.copied, block) == block


@pytest.mark.parametrize("between", ["\n", "\n<!-- end of library -->\n"])
@pytest.mark.parametrize(("rows", "is_folded"), [(16, False), (17, True)])
def test_long_tables_of_results_are_folded(hooks, rows, is_folded, between):
    body = "<tr><th>model</th></tr>" + "<tr><td>1</td></tr>" * rows
    table = f"<table>{body}</table>{between}<p>Table: masses.</p>"
    made = hooks.TABLE.sub(hooks.folded, table)
    assert made.startswith("<details") == is_folded
    assert (f"<summary>{rows} rows: masses</summary>" in made) == is_folded


@pytest.mark.parametrize("page", PAGES)
def test_pictures_have_alternative_texts(page):
    assert re.findall(r"!\[\s*\]\(.*?\)", (ROOT / page).read_text()) == []


@pytest.mark.parametrize("page", PAGES)
def test_formulas_are_closed(page):
    """A dollar sign outside of code is part of a pair."""
    if page != "README.md":
        assert FENCE.sub("", (ROOT / page).read_text()).count("$") % 2 == 0


@pytest.mark.parametrize("page", PAGES)
def test_tags_in_pages_are_code(page):
    """A backslash before a tag is shown, and the tag disappears: it becomes an element of the HTML page."""
    assert re.findall(r"\\<.{0,30}", FENCE.sub("", (ROOT / page).read_text())) == []


@pytest.mark.parametrize("term", TERMS)
def test_terms_of_the_field_occur_in_pages(term):
    """The search of the site finds words of pages only."""
    assert [page for page in PAGES if term.lower() in (ROOT / page).read_text().lower()]


def test_the_footer_has_the_version_and_its_date(hooks):
    def git(*command: str) -> str:
        done = subprocess.run(["git", "-C", str(ROOT), *command], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    note = hooks.version_note()
    if (ROOT / ".git").exists():
        assert git("rev-parse", "--short", "HEAD") in note
        assert git("log", "-1", "--format=%cs") in note
    else:
        assert version("crosscheck-dynamics") in note


def test_tasks_of_commands_have_one_page_each(hooks):
    pages = [page.read_text() for page in (ROOT / "docs" / "reference" / "commands").glob("*.md")]
    assert sorted(task for page in pages for task in hooks.COMMANDS.findall(page)) == sorted(TASKS)


def test_the_index_has_each_documented_name_once_with_its_path_and_description(hooks):
    index = (ROOT / "docs" / "reference" / "python.md").read_text()
    groups = [group.split() for group in hooks.INDEX_OF_NAMES.findall(index)]
    listed = sorted(page for group in groups for page in group)
    assert listed == sorted(page.stem for page in (ROOT / "docs/reference/python").iterdir())
    assert set(hooks.pages_of(navigation(), "reference/python/")) == {
        f"reference/python/{page}.md" for page in listed
    }
    public = [row for group in groups for row in list(hooks.index_of_names(group))[1:]]
    results = list(hooks.index_of_results(SimpleNamespace(nav=navigation())))[1:]
    anchors = [re.findall('<a id="([^"]+)"', row)[0] for row in (*public, *results)]
    documented = [name for page in listed for name, _ in hooks.NAME.findall(_text_of_names(page))]
    assert sorted(anchors) == sorted(documented)
    assert all(re.search(r"\) \| (`[\w.]+` \| )?[A-Z].* \|$", row) for row in (*public, *results))
    rows = "\n".join(public)
    assert "[`newton_euler.simulate`](python/simulate.md#newton_euler.runs.simulate.simulate) | Run " in rows
    assert "[`newton_euler.JointSpring`](python/forces.md#newton_euler.JointSpring)" in rows
    assert "[`Check`](python/verdict.md#crosscheck.compare.check.Check)" in "\n".join(results)


def test_public_names_can_be_imported_from_their_paths_in_the_index(hooks):
    for page in (ROOT / "docs" / "reference" / "python").iterdir():
        for name, heading in hooks.NAME.findall(page.read_text()):
            package, _, exported = heading.rpartition(".")
            if package and hooks.is_public(page.stem, name, heading):
                assert hasattr(importlib.import_module(package), exported), heading


def _text_of_names(page: str) -> str:
    """The source of a page of the Python reference."""
    return (ROOT / "docs" / "reference" / "python" / f"{page}.md").read_text()


def navigation() -> object:
    """The navigation of the site, without the tags of MkDocs."""
    text = (ROOT / "mkdocs.yml").read_text()
    return yaml.safe_load(text[text.index("nav:") :])["nav"]


def test_names_of_engines_in_the_glossary_exist():
    table = GLOSSARY.read_text().partition("| term | MuJoCo | Pinocchio |")[2]
    rows = [line.split("|")[1:] for line in table.splitlines() if line.startswith("| ")]
    mjcf_and_mujoco = _names_of_mujoco()
    pin = pytest.importorskip("pinocchio")
    kinds = (pin, pin.Data, pin.Model, pin.Inertia, pin.RigidConstraintModel, pin.RigidConstraintData)
    pinocchio = {"q", *(name for kind in kinds for name in dir(kind))}
    for column, known in ((1, mjcf_and_mujoco), (2, pinocchio)):
        named = {name for row in rows for name in re.findall(r"`(\w+)`", row[column])}
        assert len(named) > 20
        assert named - known == set()


def _names_of_mujoco() -> set[str]:
    """Names of MuJoCo's functions and fields, and of elements and attributes of MJCF and joint types."""
    mujoco = pytest.importorskip("mujoco")
    kinds = (mujoco, mujoco.MjData, mujoco.MjModel)
    schema = re.findall(r"\w+", mujoco.mj_printSchema(False, False))
    joints = {name.removeprefix("mjJNT_").lower() for name in dir(mujoco.mjtJoint)}
    return {*schema, *joints, *(name for kind in kinds for name in dir(kind))}


@pytest.mark.slow  # builds the site
def test_the_site_is_built_with_links_to_edit_next_pages_and_a_search_index(tmp_path):
    pytest.importorskip("mkdocs")
    links = {"DOCS_REPO_URL": "https://example.org/mine", "DOCS_EDIT_URI": "edit/main/docs/"}
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", tmp_path],
        cwd=ROOT,
        env=os.environ | links | {"PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"},
        check=True,
    )
    page = (tmp_path / "explanation" / "coverage" / "index.html").read_text()
    assert 'href="https://example.org/mine/edit/main/docs/explanation/coverage.md"' in page
    assert re.search('<a href="[^"]*" class="md-footer__link md-footer__link--prev"', page)
    assert re.search('<a href="[^"]*" class="md-footer__link md-footer__link--next"', page)
    assert re.search(r'<div class="md-copyright__highlight">\s*crosscheck', page)
    loaded = re.findall(r'<(?:script|img|link)[^>]*(?:src|href)="(https?:[^"]*)"', page)
    assert loaded == []  # the site works without a network
    index = json.loads((tmp_path / "search" / "search_index.json").read_text())
    texts = [f"{entry['title']} {entry['text']}".lower() for entry in index["docs"]]
    assert [term for term in TERMS if not any(term.lower() in text for text in texts)] == []
