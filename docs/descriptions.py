"""Griffe extension: constructors of the dataclasses that `newton_euler.model.description` makes.

Attributes of a class that are annotated with `ClassVar` alone are no arguments of the constructor.
"""

from __future__ import annotations

from typing import Any

from griffe import Alias, Attribute, Class, Decorator, ExprName, Extension, Module

PATH = "newton_euler.model.description.description"


class Descriptions(Extension):
    """Adds the decorator of the standard library, which Griffe knows, and labels attributes of classes."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        annotation = attr.annotation
        if isinstance(annotation, ExprName) and annotation.canonical_path == "typing.ClassVar":
            attr.labels.discard("instance-attribute")

    def on_class_instance(self, *, cls: Class, **_: Any) -> None:
        for decorator in list(cls.decorators):
            if isinstance(decorator.value, ExprName) and decorator.value.canonical_path == PATH:
                scope = Module("scope")
                scope["dataclass"] = Alias("dataclass", "dataclasses.dataclass")
                known = Decorator(
                    ExprName("dataclass", scope), lineno=decorator.lineno, endlineno=decorator.endlineno
                )
                cls.decorators.append(known)
