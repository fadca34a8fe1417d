"""Griffe extension: what the Python reference shows of signatures and docstrings.

- Constructors of the dataclasses that `newton_euler.model.description` makes have their arguments.
- Private attributes and attributes of classes (`ClassVar`) are no arguments of a constructor.
- Named constants in signatures are replaced by their numbers and texts.
- A line `start, end: ...` in the attributes or arguments of a docstring describes both.
- Attributes that a constructor sets, as those of errors, have the types of its arguments.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any

from griffe import (
    Alias,
    AliasResolutionError,
    Attribute,
    Class,
    Decorator,
    Expr,
    ExprName,
    ExprSubscript,
    ExprTuple,
    Extension,
    Function,
    Module,
    Object,
)

PATH = "newton_euler.model.description.description"

CONSTANT = re.compile(r"[A-Z][A-Z0-9_]+")

UNCHECKED = "UNCHECKED"
"""Mark of an annotation that the runtime check of arguments skips; it says nothing to readers."""

MERGED = re.compile(r"^( +)(\w+(?:, \w+)+)(?=: )", re.MULTILINE)
"""Names of several attributes that a docstring describes in one line."""

UNSEEN = re.compile(r"^ {4}(\w+)(?=: )", re.MULTILINE)
"""Name of an attribute or argument in a docstring, without a type."""

NEXT_SECTION = re.compile(r"^\w+:\n", re.MULTILINE)
"""Heading of the section after attributes or arguments, such as "Raises:"."""

NO_BREAK = "\u00a0"
"""Space that Griffe does not take for the end of an attribute's name."""

LONGEST_VALUE = 60
"""Length of the longest value of a constant that replaces its name, characters."""


class Descriptions(Extension):
    """Adds what Griffe does not see in the source, before signatures and docstrings are rendered."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        """Label attributes that are no arguments of a constructor."""
        annotation = attr.annotation
        is_class_variable = (
            isinstance(annotation, ExprName) and annotation.canonical_path == "typing.ClassVar"
        )
        if is_class_variable or attr.name.startswith("_"):
            attr.labels.discard("instance-attribute")
            attr.labels.add("class-attribute")

    def on_class_instance(self, *, cls: Class, **_: Any) -> None:
        """Add the decorator of the standard library, which Griffe knows."""
        for decorator in list(cls.decorators):
            if isinstance(decorator.value, ExprName) and decorator.value.canonical_path == PATH:
                scope = Module("scope")
                scope["dataclass"] = Alias("dataclass", "dataclasses.dataclass")
                known = Decorator(
                    ExprName("dataclass", scope), lineno=decorator.lineno, endlineno=decorator.endlineno
                )
                cls.decorators.append(known)

    def on_package(self, *, pkg: Module, **_: Any) -> None:
        """Complete all objects of a package."""
        for each in objects(pkg):
            if each.docstring:
                section = "Args:\n" if isinstance(each, Function) else "Attributes:\n"
                head, title, rest = each.docstring.value.partition(section)
                end = following.start() if (following := NEXT_SECTION.search(rest)) else len(rest)
                names = MERGED.sub(partial(joined, each), rest[:end])
                names = UNSEEN.sub(partial(typed, each), names)
                each.docstring.value = head + title + names + rest[end:]
            if isinstance(each, Function):
                for parameter in each.parameters:
                    parameter.default = with_values(parameter.default)
                    parameter.annotation = with_values(parameter.annotation)
            elif isinstance(each, Attribute) and isinstance(each.parent, Class):
                each.value = with_values(each.value)
                if each.annotation is None and (init := each.parent.members.get("__init__")):
                    for name in (str(each.value), each.name):  # `self.name = argument`
                        with suppress(KeyError, AttributeError):
                            each.annotation = each.annotation or init.parameters[name].annotation


def objects(parent: Object) -> Iterator[Object]:
    """Yield an object and all objects in it."""
    yield parent
    for member in parent.members.values():
        if isinstance(member, Object):
            yield from objects(member)


def joined(owner: Object, names: re.Match[str]) -> str:
    """Return the names of a line, joined so that Griffe takes them for one name, and their type.

    Args:
        owner: object with these attributes.
        names: indentation and names.
    """
    name = names[2].partition(",")[0]
    if isinstance(owner, Function):
        first: Any = next((each for each in owner.parameters if each.name == name), None)
    else:
        first = owner.members.get(name) or inherited(owner, name)
    annotation = getattr(first, "annotation", None) or ""
    return f"{names[1]}{names[2].replace(', ', f',{NO_BREAK}')} ({annotation})"


def typed(owner: Object, name: re.Match[str]) -> str:
    """Return the name of an attribute that Griffe does not see, and the type of the constructor's argument.

    Griffe does not see attributes in assignments such as `self.first, self.second = first, second`.

    Args:
        owner: object with this attribute.
        name: indentation and name.
    """
    init = owner.members.get("__init__") if isinstance(owner, Class) else None
    if not isinstance(init, Function) or name[1] in owner.members or name[1] not in init.parameters:
        return name[0]
    return f"{name[0]} ({init.parameters[name[1]].annotation})"


def inherited(owner: Object, name: str) -> Object | Alias | None:
    """Return an attribute of a base class; None if there is none."""
    with suppress(AliasResolutionError, KeyError):
        if isinstance(owner, Class):
            return next((base.members[name] for base in owner.mro() if name in base.members), None)
    return None


def with_values(expression: Any) -> Any:
    """Return an expression in which numbers and texts replace the names of constants.

    Args:
        expression: expression of Griffe, a list of expressions, or any other value, which is returned.
    """
    if isinstance(expression, ExprName):
        return constant(expression) if CONSTANT.fullmatch(expression.name) else expression
    if isinstance(expression, list):
        return [with_values(each) for each in expression]
    if not isinstance(expression, Expr) or not is_dataclass(expression):
        return expression
    if isinstance(expression, ExprSubscript) and isinstance(expression.slice, ExprTuple):
        elements = expression.slice.elements
        if [str(mark) for mark in elements[1:]] == [UNCHECKED]:
            return with_values(elements[0])
    for field in fields(expression):
        if field.name != "parent":
            setattr(expression, field.name, with_values(getattr(expression, field.name)))
    return expression


def constant(name: ExprName) -> str | ExprName:
    """Return the value of a constant as text; the name itself if the value is long or not written out."""
    scope = name.parent
    with suppress(AliasResolutionError, KeyError, AttributeError, ValueError, SyntaxError):
        while not isinstance(scope, Module):
            scope = scope.parent
        found = scope[name.name]
        value = str((found.final_target if found.is_alias else found).value)
        ast.literal_eval(value)
        return value if len(value) <= LONGEST_VALUE else name
    return name
