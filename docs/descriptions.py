"""Griffe extension: constructors of the dataclasses that `newton_euler.model.description` makes."""

from __future__ import annotations

from typing import Any

from griffe import Alias, Class, Decorator, ExprName, Extension, Module

PATH = "newton_euler.model.description.description"


class Descriptions(Extension):
    """Adds the decorator of the standard library, which Griffe knows."""

    def on_class_instance(self, *, cls: Class, **_: Any) -> None:
        for decorator in list(cls.decorators):
            if isinstance(decorator.value, ExprName) and decorator.value.canonical_path == PATH:
                scope = Module("scope")
                scope["dataclass"] = Alias("dataclass", "dataclasses.dataclass")
                known = Decorator(
                    ExprName("dataclass", scope), lineno=decorator.lineno, endlineno=decorator.endlineno
                )
                cls.decorators.append(known)
