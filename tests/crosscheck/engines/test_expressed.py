"""The page of the five engines has what they say of themselves: which can express what."""

from __future__ import annotations

import pytest
from engine_tables import PAGE, expressed, replaced

from crosscheck.engines.registry import ENGINES, OPTIONAL, NotInstalledError, choose


def test_the_page_has_what_engines_cannot_express():
    try:
        engines = choose([*ENGINES, *OPTIONAL])
    except NotInstalledError as error:
        pytest.skip(str(error))
    page = PAGE.read_text()
    assert page == replaced(page, "expressed", expressed(engines))
