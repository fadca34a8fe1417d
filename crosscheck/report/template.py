"""Render the HTML templates of this folder with jinja2, which escapes all texts."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from crosscheck.report.render import printable

FOLDER = Path(__file__).parent
"""Folder of the templates, of the style and of the script of pages."""


def rendered(template: str, **content: object) -> str:
    """Render an HTML template with the given variables; all texts in them are escaped."""
    environment = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        # `type`, since jinja2's own text, which is already escaped, is a subclass of str
        finalize=lambda value: printable(value) if type(value) is str else value,
        keep_trailing_newline=True,
    )
    # the only script that a page allows, which it recognizes by the checksum
    script, style = ((FOLDER / name).read_text(encoding="utf-8") for name in ("filter.js", "style.css"))
    checksum = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment.globals |= {
        "script": Markup(script),
        "script_checksum": f"sha256-{checksum}",
        "style": Markup(style),
    }
    return environment.get_template(template).render(**content)
