# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Change a subpackage at random, and see whether one of its tests fails.

    python tools/mutation.py ROOM [ROOM ...] [--number 45] [--seed 1]

copies the repository to a temporary folder and draws ``--number`` mutants of each room:
a mutant has another comparison, operator, number, bound of a slice or function (``min``
for ``max``), a negated condition, two exchanged arguments, no keyword argument or call
where there was one, or returns nothing.  Text, annotations, decorators, ``raise`` and
``__repr__`` are not changed.  A mutant is killed if a test in ``tests/ROOM`` fails, or
if the tests take ten times as long as usual.  The share of killed mutants, with a 95%
interval, and the mutants that survive are printed.
"""

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from scipy.stats import binomtest

REPO = Path(__file__).parents[1]
IGNORED = shutil.ignore_patterns(
    *(".git", ".venv*", "__pycache__", ".hypothesis", "_build", "api", "results")
)
#: Tests count as hanging after this many times their usual time plus some seconds.
SLOWER, GRACE = 10, 20
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitAnd,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
#: Functions and methods, and what replaces them.
FUNCTIONS = {
    "min": "max", "max": "min", "any": "all", "all": "any", "sin": "cos", "cos": "sin",
    "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin",
    "nanmin": "nanmax", "nanmax": "nanmin", "floor": "ceil", "ceil": "floor",
    "zeros": "ones", "ones": "zeros", "sum": "max", "mean": "max", "median": "max",
}  # fmt: skip
#: Functions whose arguments can be exchanged without effect.
SYMMETRIC = {
    *("min", "max", "minimum", "maximum", "hypot", "array_equal", "isinstance"),
    *("union1d", "intersect1d", "logical_and", "logical_or"),
}


@dataclass(frozen=True)
class Mutant:
    """
    One changed expression of a module.

    Attributes
    ----------
    path : `~pathlib.Path`
        Path of the module.
    node, variant, line : int
        Number of the node of the syntax tree, number of its change, and line.
    before, after : str
    """

    path: Path
    node: int
    variant: int
    line: int
    before: str
    after: str

    def __str__(self):
        return f"{self.path.name}:{self.line} {self.before}  ->  {self.after}"


def changes(node):
    """Return the nodes that may replace a node."""

    def with_(**fields):
        other = copy.copy(node)
        other.__dict__.update(fields)
        return other

    match node:
        case ast.Compare():
            return [
                with_(ops=[*node.ops[:k], other(), *node.ops[k + 1 :]])
                for k, op in enumerate(node.ops)
                for other in COMPARISONS[type(op)]
            ]
        case ast.BinOp(left=ast.JoinedStr() | ast.Constant(value=str())):
            return []
        case ast.BinOp() | ast.BoolOp() | ast.AugAssign() if type(node.op) in OPERATORS:
            return [with_(op=OPERATORS[type(node.op)]())]
        case ast.UnaryOp():
            return [node.operand]
        case ast.Constant(value=bool()):
            return [with_(value=not node.value)]
        case ast.Constant(value=int() | float()):
            return [with_(value=node.value + 1), with_(value=node.value - 1)]
        case ast.Call():
            return changed_calls(node, with_)
        case ast.Return(value=ast.expr() as value) if not isinstance(
            value, ast.Constant
        ):
            return [with_(value=ast.Constant(None))]
        case ast.Slice():
            lower = None if node.lower else ast.Constant(1)
            upper = None if node.upper else ast.Constant(-1)
            return [with_(lower=lower), with_(upper=upper)]
        case ast.If() | ast.While() | ast.IfExp() if not isinstance(
            node.test, ast.Compare | ast.BoolOp | ast.UnaryOp
        ):
            return [with_(test=ast.UnaryOp(ast.Not(), node.test))]
        case ast.Expr(value=ast.Call()):
            return [ast.Pass()]
    return []


def changed_calls(node, with_):
    """Return calls without one keyword argument, with exchanged arguments, or of
    another function."""
    found = [
        with_(keywords=[other for other in node.keywords if other is not word])
        for word in node.keywords
        # zip(strict=True) is only an assertion.
        if word.arg not in (None, "strict")
    ]
    name = getattr(node.func, "id", getattr(node.func, "attr", None))
    starred = any(isinstance(arg, ast.Starred) for arg in node.args)
    if len(node.args) > 1 and not starred and name not in SYMMETRIC:
        *first, a, b = node.args
        found.append(with_(args=[*first, b, a]))
    if name in FUNCTIONS:
        function = copy.copy(node.func)
        setattr(function, "id" if hasattr(function, "id") else "attr", FUNCTIONS[name])
        found.append(with_(func=function))
    return found


def left_alone(node):
    """Return whether a node is left unchanged."""
    match node:
        case ast.Raise() | ast.JoinedStr() | ast.Import() | ast.ImportFrom():
            return True
        case ast.FunctionDef(name="__repr__" | "__str__"):
            return True
        case ast.Expr(value=ast.Constant()):
            return True
        case ast.Assign(targets=[ast.Name(id="__all__")]):
            return True
        case ast.Expr(
            value=ast.Call(func=ast.Attribute(value=ast.Name(id="warnings")))
        ):
            return True
    return False


def mutants_of(path):
    """Return all mutants of a module."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    numbers = {id(node): k for k, node in enumerate(ast.walk(tree))}
    found = []

    def visit(node, line):
        if left_alone(node):
            return
        line = getattr(node, "lineno", line)
        for variant, other in enumerate(changes(node)):
            before, after = text_of(node), text_of(other)
            if before != after:
                found.append(
                    Mutant(path, numbers[id(node)], variant, line, before, after)
                )
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns", "decorator_list"):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        visit(child, line)

    visit(tree, 1)
    return found


def text_of(node):
    """Return the code of a node, or the condition of a statement with a body."""
    if isinstance(node, ast.If | ast.While):
        return f"if {ast.unparse(node.test)}"
    if isinstance(node, ast.Slice):
        return f"[{ast.unparse(node)}]"
    return " ".join(ast.unparse(node).split())


def mutated(mutant):
    """Return the source of a module with one expression changed."""
    tree = ast.parse(mutant.path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    old = nodes[mutant.node]
    new = changes(old)[mutant.variant]
    for parent in nodes:
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
            elif isinstance(value, list):
                value[:] = [new if item is old else item for item in value]
    return ast.unparse(ast.fix_missing_locations(tree)) + "\n"


def fails(clone, room, limit=None):
    """Return whether a test of a room fails in a copy of the repository."""
    words = ["-x", "-q", "-n0", "-p", "no:cacheprovider", f"tests/{room}"]
    # The bytecode of one mutant must not be used for another.
    environment = os.environ | {
        "PYTHONPATH": str(clone), "PYTHONDONTWRITEBYTECODE": "1", "CI": "1"
    }  # fmt: skip
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *words], cwd=clone, env=environment,
            timeout=limit, capture_output=True, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


def survivors_of(clone, room, number, seed):
    """Return the number of mutants drawn of a room, and those that survive."""
    start = time.monotonic()
    if fails(clone, room):
        raise SystemExit(f"tests/{room} fails without any change")
    limit = GRACE + SLOWER * (time.monotonic() - start)
    modules = sorted((clone / "astro_scc").glob(f"{room}.py"))
    modules += sorted((clone / "astro_scc" / room).rglob("*.py"))
    every = [mutant for path in modules for mutant in mutants_of(path)]
    drawn = random.Random(f"{room} {seed}").sample(every, min(number, len(every)))
    left = []
    for mutant in drawn:
        source = mutant.path.read_text(encoding="utf-8")
        mutant.path.write_text(mutated(mutant), encoding="utf-8")
        killed = fails(clone, room, limit)
        mutant.path.write_text(source, encoding="utf-8")
        left += [] if killed else [mutant]
        print("killed  " if killed else "survived", mutant, file=sys.stderr, flush=True)
    return len(drawn), left


def main():
    """Print the shares of killed mutants, and the mutants that survive."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("rooms", nargs="+", metavar="ROOM")
    parser.add_argument("--number", type=int, default=45, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "clone"
        shutil.copytree(REPO, clone, ignore=IGNORED)
        for room in args.rooms:
            n, left = survivors_of(clone, room, args.number, args.seed)
            killed = n - len(left)
            low, high = binomtest(killed, n).proportion_ci()
            print(f"{room}: {killed} of {n} killed ({low:.1%} to {high:.1%})")
            print(*(f"    {mutant}" for mutant in left), sep="\n", flush=True)


if __name__ == "__main__":
    main()
