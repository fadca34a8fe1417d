"""Mutation score of some source: a seeded sample of cosmic-ray's mutants, each run against some tests.

    python tests/support/mutants.py newton_euler/equations tests/newton_euler/equations --count 60 --seed 1

The mutants are made in a copy of the source, one at a time, as many of each file as the file has places to
change. A mutant that no test kills shows a missing test, or a change without effect.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shlex
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_and_test, mutate_code
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import WorkDB
from cosmic_ray.work_item import MutationSpec

sys.path.insert(0, str(Path(__file__).parents[1]))
from test_mutations import copy_source

UNLIKELY = re.compile(
    r"BinaryOperator_\w+_(RShift|LShift|BitOr|BitAnd|BitXor|Mod|FloorDiv|Pow)$"
    r"|BinaryOperator_(RShift|LShift|BitOr|BitAnd|BitXor)_|Invert|UAdd|(?<!_IsNot)_Is$|(?<!_Is)_IsNot$"
)
"""Operators of cosmic-ray whose mutants nobody writes; nearly each mutant raises a TypeError."""


class Effective(ast.NodeTransformer):
    """A module without what no test needs to notice: annotations, @abstractmethod, `strict` of zip."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AnnAssign:
        node.annotation = ast.Constant("")
        self.generic_visit(node)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.returns = None
        node.decorator_list = [each for each in node.decorator_list if ast.unparse(each) != "abstractmethod"]
        self.generic_visit(node)
        return node

    def visit_Call(self, node: ast.Call) -> ast.Call:
        node.keywords = [each for each in node.keywords if each.arg not in ("strict", "frozen")]
        self.generic_visit(node)
        return node


def effective(text: str) -> str:
    return ast.dump(Effective().visit(ast.parse(text)))


def is_effective(mutation: MutationSpec) -> bool:
    """Return True for a mutant that is Python and changes what the module does."""
    text = mutation.module_path.read_text()
    mutant = mutate_code(text, get_operator(mutation.operator_name)(), mutation.occurrence)
    try:
        return mutant is not None and effective(mutant) != effective(text)
    except SyntaxError:
        return False


def sample(sources: list[str], count: int, seed: int) -> Iterator[MutationSpec]:
    """Draw places of all files, each file in proportion to its places, and one mutant of each place."""
    rng = random.Random(seed)
    files = [
        path for source in map(Path, sources) for path in [*source.rglob("*.py"), source] if path.is_file()
    ]
    work = WorkDB(":memory:", WorkDB.Mode.create)
    init(files, work, {})
    found = [item.mutations[0] for item in work.work_items]
    places: dict[tuple[Path, tuple[int, int]], list[MutationSpec]] = defaultdict(list)
    for each in sorted(found, key=lambda m: (m.module_path, m.start_pos, m.operator_name, m.occurrence)):
        if not UNLIKELY.search(each.operator_name):
            places[each.module_path, each.start_pos].append(each)
    # every n-th place after a random first one is a sample stratified by file
    every, first = max(1.0, len(places) / count), rng.random()
    chosen = [list(places.values())[int((k + first) * every)] for k in range(min(count, len(places)))]
    for mutations in chosen:
        yield from [each for each in rng.sample(mutations, len(mutations)) if is_effective(each)][:1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("source", nargs="+", help="folders and files to mutate, then those of the tests")
    parser.add_argument("--count", type=int, default=60, help="mutants (60)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample (1)")
    options = parser.parse_args()
    sources = [each for each in options.source if not each.startswith("tests")]
    tests = [each for each in options.source if each.startswith("tests")]
    command = shlex.join([sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests])
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(copy_source(Path(folder, "project")))
        # the copy comes first on the path; machine code of mutants stays out of the user's cache
        os.environ |= {"PYTHONPATH": os.getcwd(), "NEWTON_EULER_CACHE": os.path.join(folder, "cache")}
        start = time.perf_counter()
        assert os.system(command) == 0, "the tests fail without a mutant"
        limit = 60.0 + 3.0 * (time.perf_counter() - start)
        outcomes: Counter[str] = Counter()
        for mutation in sample(sources, options.count, options.seed):
            result = mutate_and_test([mutation], command, limit)
            outcome = "timeout" if result.output == "timeout" else str(result.test_outcome.value)
            outcomes[outcome] += 1
            place = f"{mutation.module_path}:{mutation.start_pos[0]}"
            print(f"{outcome:<9} {place} {mutation.operator_name}", flush=True)
            if outcome == "survived":
                print(result.diff, flush=True)
    print(f"{outcomes.total() - outcomes['survived']} of {outcomes.total()} mutants killed: {dict(outcomes)}")


if __name__ == "__main__":
    main()
