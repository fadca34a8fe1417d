"""All pictures of the documentation, made by `make pictures`, and what each is made from.

Each picture carries a digest of its content, which a test compares with what is printed, logged and laid out
today: no picture is taken for that. Contents leave out what depends on the machine, as `words` says: times,
figures and where they are worst. Terminals are shown by rich, pages by Chromium, recordings by Rerun's viewer
with a Vulkan driver, in software or not.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import os
import pty
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import moving_picture
import numpy as np
from command_plots import PLOTS, page_files, plot_command
from guide_plots import GUIDE_PLOTS, guide_content
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo
from recordings import read_recording
from rerun.chunk import RrdReader
from result_plots import RESULT_PLOTS, result_content
from rich.console import Console
from rich.text import Text
from theory_plots import THEORY_PLOTS, theory_content
from wrong_engines import taking

import newton_euler
from crosscheck.cli import main
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.recording.log import log_run
from crosscheck.recording.screenshot import MECHANISM, screenshots
from crosscheck.recording.stream import recorded
from crosscheck.report import page
from crosscheck.report.entry import key_times
from crosscheck.report.page import PAGE
from crosscheck.studies.faults import injection
from crosscheck.studies.paper_figures import FIGURES

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
NOTEBOOK = ROOT / "docs" / "tutorial" / "notebook.ipynb"

SCENES = ("tracker", "four_bar", "stewart", "slider_crank", "bricard")
"""Of which there are pictures of recordings."""

WIDTHS = {"run_80": 80, "run_120": 120}
"""Columns of the pictures of a run of the tracker."""

PAGES = {"page": (1200, 1250), "page_phone": (400, 1250)}
"""Pixels of the pictures of its page."""

WRONG = ("slider_crank", "rod", 0.05)
"""Scene of a disagreement: the body that MuJoCo is told is heavier by a share."""

NOTEBOOK_SIZE = (1000, 1250)

TITLE, LOWER_ROW = (37, 66), (401, 908)
"""Pixels at which the title of the mechanism and the lower row of a recording's layout begin and end."""

COLORS = 128
"""Of a picture."""

NEARLY_WHITE = 250
"""Channels of colors that are white, and that the reduction of colors makes a little darker."""

WIDGET = "application/vnd.jupyter.widget-view+json"
"""Type of outputs that only a running notebook shows."""

MADE_FROM = "made from"
"""Name of the digest in a picture."""

STALE = "is not of what crosscheck shows today; `make pictures` makes all of them"


# Contents


def digest(*contents: str) -> str:
    """Short digest of what a picture is made from."""
    return hashlib.sha256("\n".join(contents).encode()).hexdigest()[:16]


def made_from(picture: str) -> str:
    """Digest that a picture carries."""
    path = IMAGES / picture
    if path.suffix == ".svg":
        found = re.search(f"<!-- {MADE_FROM} (\\w+) -->", path.read_text())
        return found[1] if found else ""
    with Image.open(path) as image:
        if path.suffix == ".gif":
            return bytes(image.info.get("comment", b"")).decode()
        return str(image.text.get(MADE_FROM, ""))


def words(text: str) -> str:
    """What a text says on any processor: without figures, where they are worst, and fastest settings."""
    text = re.sub(r"(\d+ ok|\d+/\d+ FAIL).*", r"\1", text)
    # times of a benchmark, and the fastest settings
    text = re.sub(r"(?m)^(\w+)(\s+[\d.,-]+){4,}.*", r"\1", text)
    text = re.sub(r"(?m)^(\w+ for [\d.e-]+:).*(\n  .*)*", r"\1", text)
    text = re.sub(r"[-+]?\d[\d.,]*(e[-+]?\d+)?( [mu]?s\b)?", "#", text)
    lines = (" ".join(line.split()) for line in text.splitlines())
    return " ".join(line for line in lines if re.search(r"[a-z]", line) and "cores" not in line)


def page_words(text: str) -> str:
    """The same of a page without its tables, which hold what is printed, and what is folded."""
    text = re.sub(r"base64,[^\"]*", "", text)
    return words(re.sub(r"(?s)<td.*?</td>|(?<=</summary>).*?</details>", "", text))


def shown(scene: str) -> str:
    """Content of a scene's recording as JSON: shapes, layout, and poses at the times that are shown.

    It is of newton_euler's run alone, in the place of all engines'.
    """
    loaded = load(scene)
    run = newton_euler.simulate(loaded)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        runs, moments = dict.fromkeys(ENGINES, run), [(0.0, "start")]
        path.write_bytes(recorded(log_run, loaded, runs, "", scene, None, moments))
        found, layout = read_recording(path), _layout(path)
    moments = key_times(run.arrays())
    poses = {}
    for (entity, component), column in found.columns.items():
        if component.startswith(("Transform3D", "Points3D")) and len(column) == len(run.time):
            poses[f"{entity} {component}"] = [column[int(np.searchsorted(run.time, t))] for t in moments]
    static = {f"{entity} {name}": value for (entity, name), value in found.static.items()}
    static = {name: value for name, value in static.items() if not name.startswith("/__properties")}
    content = {"static": static, "poses": poses, "entities": sorted(found.entities), "layout": layout}
    return json.dumps(_rounded(content), sort_keys=True, default=str)


def notebook_content() -> str:
    """Code of the notebook, and how it shows a verdict."""
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    templates = [(Path(page.__file__).parent / name).read_text() for name in ("summary.html", "parts.html")]
    return "\n".join(["".join(cell["source"]) for cell in cells] + templates)


PAPER = {5: "paper_5", 6: "drift", 7: "paper_7", 8: "paper_8", 9: "paper_9"}
"""Pictures of the paper's figures, by the number of the figure."""


def figure_content(number: int, tracker: str) -> str:
    """Content of a figure of the paper: the code that draws the figure, and the run of the tracker.

    Args:
        number: number of the figure.
        tracker: `shown("tracker")`.
    """
    return inspect.getsource(FIGURES[number]) + tracker


def verdict_words(rrd: Path) -> str:
    """Words of the verdict in a recording."""
    return words(read_recording(rrd).static["/verdict", "TextDocument:text"][0])


def _layout(path: Path) -> list[str]:
    """Components of a blueprint, without identifiers, which are random."""
    reader = RrdReader(path)
    (entry,) = reader.blueprints()
    found = []
    for chunk in reader.stream(store=entry):
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if ":" in name and not name.endswith("root_container"):
                found.append(f"{name} {_rounded(batch.column(name).to_pylist())}")
    return sorted(line for line in found if not re.search(r"[0-9a-f]{8}-", line))


def _rounded(value: object) -> object:
    """Numbers to three decimals; those that come out of a decimal or a half stay clear of the border."""
    if isinstance(value, float):
        return int(np.floor(1e3 * value + 0.3183))
    if isinstance(value, dict):
        return {name: _rounded(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    return value


def wrong_engine() -> Engine:
    """MuJoCo, told that a body is heavier than it is."""
    return taking(ENGINES["mujoco"], injection.mass(*WRONG[1:]))


# Pictures


def environment(columns: int) -> dict[str, str]:
    """Environment of commands, which are those of this copy."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    told = {"COLUMNS": str(columns), "TERM": "xterm-256color", "PYTHONPATH": str(ROOT), "PATH": path}
    return os.environ | told


def terminal(
    name: str, command: Sequence[str], shown_as: str, width: int, folder: Path, content: str = ""
) -> str:
    """Write a picture of what a command prints on a terminal; returns what it is made from.

    Args:
        content: the same, where wider terminals show more of it.
    """
    leader, follower = pty.openpty()
    streams = {"stdin": follower, "stdout": follower, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, **streams, cwd=folder, env=environment(width)):
        os.close(follower)
        printed = b""
        while True:
            try:
                printed += os.read(leader, 4096)
            except OSError:  # the command has ended
                break
    os.close(leader)
    text = printed.decode().replace("\r\n", "\n")
    console = Console(record=True, width=width, file=io.StringIO())
    console.print(Text(f"$ {shown_as}"), Text.from_ansi(text), sep="\n", soft_wrap=True)
    svg = console.export_svg(title="", unique_id=name)
    svg = re.sub(r"(?s)@font-face \{.*?\}\s*", "", svg)  # nothing is fetched
    content = content or words(Text.from_ansi(text).plain)
    svg = svg.replace("<svg ", f"<!-- {MADE_FROM} {digest(content)} -->\n<svg ", 1)
    (IMAGES / f"{name}.svg").write_text(svg + "\n")
    return content


def save(
    image: Image.Image, name: str, content: str, method: Image.Quantize = Image.Quantize.MEDIANCUT
) -> None:
    """Write a picture in few colors, with the digest of what it is made from.

    `MEDIANCUT` is best for shading, `FASTOCTREE` for plots: it keeps colors that few pixels have.
    """
    told = PngInfo()
    told.add_text(MADE_FROM, digest(content))
    reduced = image.convert("RGB").quantize(COLORS, method, dither=Image.Dither.NONE)
    palette = np.reshape(reduced.getpalette(), (-1, 3))
    palette[palette.min(axis=1) > NEARLY_WHITE] = 255
    reduced.putpalette(palette.ravel().tolist())
    reduced.save(IMAGES / f"{name}.png", pnginfo=told, optimize=True)


def browser(written: Path, size: tuple[int, int]) -> Image.Image:
    """Picture of a page as Chromium shows it."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "page.png"
        quiet = ("quic", "background-networking", "component-update", "sync")
        command = [
            program,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--hide-scrollbars",
        ]
        command += [f"--disable-{name}" for name in quiet]
        command += [f"--user-data-dir={folder}/profile", f"--window-size={size[0]},{size[1]}"]
        command += [f"--screenshot={picture}", written.resolve().as_uri()]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=120)
        with Image.open(picture) as image:
            return image.copy()


def notebook(folder: Path) -> Image.Image:
    """Execute the notebook, keep what it shows without a kernel, and return its picture."""
    import nbformat
    from nbclient import NotebookClient
    from nbconvert import HTMLExporter

    content = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(content, resources={"metadata": {"path": folder}}, record_timing=False).execute()
    for cell in content.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if WIDGET not in output.get("data", {})]
    content.metadata.pop("widgets", None)
    content.metadata[MADE_FROM] = digest(notebook_content())
    nbformat.write(content, NOTEBOOK)
    written = folder / "notebook.html"
    written.write_text(HTMLExporter(template_name="lab").from_notebook_node(content)[0])
    return browser(written, NOTEBOOK_SIZE)


def sheet(folder: Path, name: str) -> Image.Image:
    """A mechanism at three times, above what its recording shows beside."""
    with np.load(folder / "newton_euler.npz") as arrays:
        moments = key_times({key: arrays[key] for key in ("time", "position")})
    rrd = folder / f"{name}.rrd"
    views = [Image.open(io.BytesIO(png)) for png in screenshots(rrd, moments, MECHANISM)]
    (whole,) = (Image.open(io.BytesIO(png)) for png in screenshots(rrd, moments[1:2]))
    title, below = (whole.crop((0, top, whole.width, end)) for top, end in (TITLE, LOWER_ROW))
    title = title.crop((0, 0, views[0].width, title.height))
    width, height = whole.width // 3, title.height + views[0].height
    drawn = Image.new("RGB", (whole.width, height + below.height))
    drawn.paste(title, (0, 0))
    drawn.paste(below, (0, height))
    for k, (moment, view) in enumerate(zip(moments, views, strict=True)):
        left = (view.width - width) // 2
        drawn.paste(view.crop((left, 0, left + width, view.height)), (k * width, title.height))
        place = (k * width + 10, title.height + 6)
        ImageDraw.Draw(drawn).text(place, f"{moment:.3g} s", "white", ImageFont.load_default(16))
    return drawn


def run(folder: Path, *arguments: str) -> Path:
    """Run a scene by crosscheck in a folder; returns the folder of results."""
    command = ["crosscheck", "run", *arguments]
    subprocess.run(command, cwd=folder, env=environment(80), stdout=subprocess.DEVNULL, check=True)
    return folder / "output" / arguments[0]


def of_runs(folder: Path) -> None:
    """Make those of the tracker on terminals and as a page, and of recordings of scenes."""
    told, command = "", ["crosscheck", "run", "tracker"]
    for name, width in WIDTHS.items():
        told = terminal(name, command, " ".join(command), width, folder, told)
    results = folder / "output" / "tracker"
    subprocess.run(["crosscheck", "report", str(results)], env=environment(80), check=True)
    for name, size in PAGES.items():
        save(browser(results / PAGE, size), name, page_words((results / PAGE).read_text()))
    pane = verdict_words(results / "tracker.rrd")
    for scene in SCENES:
        save(sheet(results if scene == "tracker" else run(folder, scene), scene), scene, shown(scene) + pane)


def of_notebook(folder: Path) -> None:
    """Make the notebook's, and its outputs."""
    save(notebook(folder), "notebook", notebook_content())


def of_disagreement(folder: Path) -> None:
    """Make those of a disagreement."""
    scene, body, share = WRONG
    title = f"crosscheck run {scene}  # mujoco's {body} made {100 * share:g} % heavier"
    told = terminal("disagree", [sys.executable, __file__, "wrong"], title, 80, folder)
    save(sheet(folder / "output" / scene, scene), "disagree", told)


def of_benchmark(folder: Path) -> None:
    """Make those of a benchmark, which takes minutes of a machine that does nothing else."""
    told = terminal("bench", ["crosscheck", "bench", "tracker"], "crosscheck bench tracker", 80, folder)
    save(Image.open(folder / "output" / "bench" / "tracker" / "work_precision.png"), "work_precision", told)


def of_paper(folder: Path) -> None:
    """Make the paper's figures."""
    subprocess.run(["crosscheck", "figures", "--output", str(folder)], env=environment(80), check=True)
    tracker = shown("tracker")
    for number, name in PAPER.items():
        save(Image.open(folder / f"figure_{number}.png"), name, figure_content(number, tracker))


def of_plots(folder: Path) -> None:
    """Make the plots and pages of commands, which are known by their commands alone."""
    for name in ("examples", "mjcf"):
        shutil.copytree(ROOT / name, folder / name)
    for name, plot in PLOTS.items():
        command = plot_command(plot)
        for file, text in page_files(plot.page).items():
            (folder / file).write_text(text)
        for each in (*plot.before, command, *plot.after):  # statuses other than 0 are results, too
            subprocess.run(each, shell=True, cwd=folder, env=environment(80), check=False)
        path = folder / "output" / plot.file
        image = browser(path, plot.window) if plot.window else Image.open(path)
        save(image, name, command, Image.Quantize.FASTOCTREE)


def of_motion(folder: Path) -> None:
    """Make the moving one."""
    moving_picture.save(IMAGES, digest(moving_picture.content()))


def of_drawings(folder: Path) -> None:
    """Make the plots that functions draw: of pages on theory, of results and of how-to pages."""
    contents = {name: (draw, theory_content(name)) for name, draw in THEORY_PLOTS.items()}
    contents |= {name: (plot.draw, result_content(name)) for name, plot in RESULT_PLOTS.items()}
    contents |= {name: (draw, guide_content(name)) for name, draw in GUIDE_PLOTS.items()}
    for name, (draw, content) in contents.items():
        draw().savefig(folder / f"{name}.png", dpi=110)
        save(Image.open(folder / f"{name}.png"), name, content, Image.Quantize.FASTOCTREE)


MAKERS = {
    "runs": of_runs,
    "notebook": of_notebook,
    "disagreement": of_disagreement,
    "benchmark": of_benchmark,
    "paper": of_paper,
    "plots": of_plots,
    "motion": of_motion,
    "drawings": of_drawings,
}
"""Makers of pictures by name: all, or those that are named on the command line."""


if __name__ == "__main__":
    if sys.argv[1:] == ["wrong"]:
        ENGINES["mujoco"] = wrong_engine()
        sys.argv = ["crosscheck"]
        main(["run", WRONG[0]])
    for chosen in sys.argv[1:] or MAKERS:
        with tempfile.TemporaryDirectory() as temporary:
            MAKERS[chosen](Path(temporary))
