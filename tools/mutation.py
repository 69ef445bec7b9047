# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Change the package at random, one expression at a time, and see whether a test fails.

    python tools/mutation.py FOLDER [--number 100] [--seed 1] [--budget 40]

copies the repository into FOLDER, runs the tests there once to learn which of them
touch which line and how long they take, and then draws ``--number`` mutants of each
room: another comparison, operator, number, bound of a slice, function (``min`` for
``max``), a condition turned round, two arguments exchanged, one that has a name or a
whole call left out, nothing returned.  Text, annotations, decorators, ``raise``,
``__repr__``, numbers of trials and constants that only bound time and memory stay as
they are.

A mutant is killed if one of the tests that touch its line fails, or they take more
than ten times as long as usual; tests of its own module and room run first, fastest
first, for as long as ``--budget`` seconds of tests.  Printed are the share that is
killed, with a 95% interval, and the mutants that survive.

What is in FOLDER is used again: ``--record`` copies the repository and runs all its
tests anew, ``--record PATH ...`` copies only the tests and adds what these touch;
``--again`` runs the survivors of an earlier run once more.  Only FOLDER is written to.
"""

import argparse
import ast
import contextlib
import copy
import importlib.util
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections import defaultdict
from pathlib import Path

import coverage
import pytest

REPO = Path(__file__).parents[1]
ROOMS = ("kinematics", "stacking", "correlation")
#: Bytes that the tests of a mutant may take.
MEMORY = 8 * 2**30
#: A mutant hangs that takes so many times as long as usual, and some seconds.
SLOWER, GRACE = 10, 20
IGNORED = shutil.ignore_patterns(
    *(".git", ".venv*", "__pycache__", ".hypothesis", "_build", "api", ".coverage*")
)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("folder", type=Path, help="for the copy; is made")
    parser.add_argument("--rooms", nargs="+", default=ROOMS, metavar="ROOM")
    parser.add_argument("--number", type=int, default=100, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--budget", type=float, default=40.0, metavar="SECONDS")
    parser.add_argument("--record", nargs="*", metavar="PATH")
    parser.add_argument("--again", action="store_true")
    args = parser.parse_args(argv)
    folder = args.folder.resolve()
    clone = folder / "clone"
    os.environ.update(
        dict.fromkeys(("CI", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
        PYTHONPATH=str(clone),
        MPLBACKEND="Agg",
    )
    if args.record is not None or not (folder / "durations.json").exists():
        paths = args.record or []
        copy_repository(folder, clone, only_tests=bool(paths))
        in_fork(lambda: record(clone, folder, paths), folder / "record.log", None)
    # Whatever an earlier run was changing when it was killed.
    shutil.rmtree(clone / "astro_scc")
    shutil.copytree(folder / "astro_scc", clone / "astro_scc")
    tests = Tests(folder, clone)
    warm_up(clone)
    results = {}
    for room in args.rooms:
        # Or all mutants would seem to be killed.
        names = tests.in_time(tests.durations, room, args.budget)
        if not names:
            parser.exit(1, f"no test passes without any change, see {folder}\n")
        if in_fork(lambda n=names[0]: attempt(clone, n), folder / "last.log", None):
            parser.exit(1, f"tests fail without any change, see {folder}/last.log\n")
        log = folder / f"{room}-{args.seed}.json"
        if args.again:
            before = json.loads(log.read_text())
            drawn = [Mutant(**m) for m, verdict in before if verdict == "survived"]
        else:
            drawn = draw(clone, room, args.number, args.seed)
        results[room] = []
        for mutant in drawn:
            verdict = judge(mutant, clone, tests, args.budget)
            results[room].append((mutant, verdict))
            print(f"{verdict:9} {mutant}", file=sys.stderr, flush=True)
        if not args.again:
            saved = [(m.__dict__, verdict) for m, verdict in results[room]]
            log.write_text(json.dumps(saved))
    given = f"--number {args.number} --seed {args.seed} --budget {args.budget:g}"
    given += " --again" * args.again
    print(f"python tools/mutation.py FOLDER {given}\n\n{summary(results)}")


def summary(results):
    """
    What became of the mutants, as text.

    Parameters
    ----------
    results : dict
        For each room a list of pairs of a mutant and its verdict.

    Returns
    -------
    str
    """
    from scipy.stats import binomtest

    lines = [
        f"{'room':12}{'mutants':>8}{'killed':>8}{'by time':>8}  share, 95% interval"
    ]
    rows = dict(results)
    if len(rows) > 1:
        rows["together"] = [pair for some in results.values() for pair in some]
    for room, pairs in rows.items():
        verdicts = [verdict for _, verdict in pairs]
        n, late = len(verdicts), verdicts.count("time")
        killed = n - verdicts.count("survived")
        if n == 0:
            continue
        low, high = binomtest(killed, n).proportion_ci()
        share = f"{killed / n:6.1%}  ({low:.1%} to {high:.1%})"
        lines.append(f"{room:12}{n:8}{killed:8}{late:8}  {share}")
    for room, pairs in results.items():
        left = [mutant for mutant, verdict in pairs if verdict == "survived"]
        if left:
            lines += ["", f"survivors in {room}"]
        for mutant in sorted(left, key=lambda m: (m.path, m.line)):
            name = mutant.path.removeprefix("astro_scc/")
            lines.append(f"{name}:{mutant.line}: {mutant.source}")
            lines.append(f"    {mutant.before}  ->  {mutant.after}")
    return "\n".join(lines)


# -- what the tests touch ------------------------------------------------------------


def copy_repository(folder, clone, *, only_tests=False):
    """
    Copy the files of the repository that tests need.

    Parameters
    ----------
    folder, clone : path
        The copy is ``clone``; what was recorded in ``folder`` is removed.
    only_tests : bool, optional
        The package and what was recorded of it stay.
    """
    if only_tests and clone.exists():
        shutil.rmtree(clone / "tests")
        shutil.copytree(REPO / "tests", clone / "tests", ignore=IGNORED)
        return
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(REPO, clone, ignore=IGNORED)
    shutil.copytree(clone / "astro_scc", folder / "astro_scc")


def record(clone, folder, paths):
    """
    Run tests once, and keep how long those that pass take, and what they touch.

    Parameters
    ----------
    clone, folder : path
    paths : sequence of str
        Tests, all by default.

    Returns
    -------
    int
        Status of pytest.
    """
    number = len(list(folder.glob("contexts.*")))
    os.environ["COVERAGE_FILE"] = str(folder / f"contexts.{number}")
    durations, failed = defaultdict(float), set()

    class Clock:
        def pytest_runtest_logreport(self, report):
            durations[report.nodeid] += report.duration
            if report.failed:
                failed.add(report.nodeid)

    coverage_of = ["--cov=astro_scc", "--cov-branch", "--cov-context=test"]
    status = run_pytest(clone, [*coverage_of, "--cov-report=", *paths], [Clock()])
    known = folder / "durations.json"
    if known.exists():
        durations = json.loads(known.read_text()) | durations
    # A test that fails without any change would kill every mutant.
    durations = {k: v for k, v in durations.items() if k not in failed}
    known.write_text(json.dumps(durations))
    return status


def run_pytest(clone, words, plugins=()):
    """
    Run pytest in a copy of the repository, in this process.

    Parameters
    ----------
    clone : path
    words : sequence of str
    plugins : sequence of object

    Returns
    -------
    int
    """
    os.chdir(clone)
    sys.path.insert(0, str(clone))
    return int(pytest.main(["-q", "-p", "no:cacheprovider", *words], [*plugins]))


class Tests:
    """
    What `record` found: the tests that touch lines.

    Parameters
    ----------
    folder, clone : path
    """

    def __init__(self, folder, clone):
        self.clone = clone
        self.durations = json.loads((folder / "durations.json").read_text())
        self.files = []
        for file in sorted(folder.glob("contexts.*")):
            data = coverage.CoverageData(basename=str(file))
            data.read()
            self.files.append(data)
        self.lines = {}

    def touching(self, path, wanted):
        """
        Names of the tests that touch one of some lines.

        Parameters
        ----------
        path : str
            Of the module, relative.
        wanted : iterable of int

        Returns
        -------
        set of str
        """
        if path not in self.lines:
            lines = self.lines[path] = defaultdict(set)
            for data in self.files:
                found = data.contexts_by_lineno(str(self.clone / path))
                for line, contexts in found.items():
                    # "" is what runs when the module is imported.
                    names = (c.rsplit("|", 1)[0] for c in contexts if c)
                    lines[line].update(n for n in names if n in self.durations)
        lines = self.lines[path]
        return set().union(*(lines[line] for line in wanted if line in lines))

    def plan(self, mutant, budget):
        """
        The tests for a mutant.

        Parameters
        ----------
        mutant : `Mutant`
        budget : float
            Seconds that all of them may take.

        Returns
        -------
        list of list of str
            As of `in_time`.
        """
        names = set()
        for lines in mutant.scopes:
            names = names or self.touching(mutant.path, lines)
        _, room, module = mutant.path.split("/")
        return self.in_time(names, room, budget, module.removesuffix(".py"))

    def in_time(self, names, room, budget, module=" "):
        """
        As many of some tests as there is time for.

        Parameters
        ----------
        names : iterable of str
        room : str
            Whose own tests come first.
        budget : float
        module : str, optional
            Those whose file has its name are the first of all.

        Returns
        -------
        list of list of str
            Of the room, and others; fastest first.
        """
        ours = (f"tests/{room}/", f"astro_scc/{room}/")
        known = self.durations
        stages = [[], []]

        def rank(name):
            file = name.split("::")[0].rsplit("/", 1)[-1]
            return not name.startswith(ours), module not in file, known[name], name

        for name in sorted(names, key=rank):
            if known[name] <= budget or not any(stages):
                budget -= known[name]
                stages[not name.startswith(ours)].append(name)
        return [stage for stage in stages if stage]


# -- mutants -------------------------------------------------------------------------


class Mutant:
    """
    One changed expression.

    Parameters
    ----------
    path : str
        Of the module, relative to the repository.
    node, variant : int
        Which node of the tree, and which of its changes.
    line : int
    source, before, after : str
        The line, the expression, and what it becomes.
    scopes : list of list of int
        Lines whose tests are to run: of the statement, or if no test touches
        that, of the function, or of the module.
    """

    def __init__(self, path, node, variant, line, source, before, after, scopes):
        self.path, self.node, self.variant, self.line = path, node, variant, line
        self.source, self.before, self.after = source, before, after
        self.scopes = scopes

    def __str__(self):
        return f"{self.path}:{self.line} {self.before}  ->  {self.after}"


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
#: Functions, and methods, that another one may stand for.
BUILTINS = {
    "min": "max", "max": "min", "any": "all", "all": "any", "abs": "float",
}  # fmt: skip
METHODS = BUILTINS | {
    "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin",
    "nanmin": "nanmax", "nanmax": "nanmin", "sin": "cos", "cos": "sin",
    "floor": "ceil", "ceil": "floor", "zeros": "ones", "ones": "zeros", "sum": "max",
    "mean": "max", "median": "max", "cumsum": "copy", "abs": "positive",
}  # fmt: skip
#: Their arguments can change places.
SYMMETRIC = BUILTINS.keys() | {
    *("minimum", "maximum", "hypot", "add", "multiply", "array_equal", "isinstance"),
    *("broadcast_arrays", "union1d", "intersect1d", "logical_and", "logical_or"),
}


#: Constants, and what is made of them, on which only time and memory depend.
EFFORT = ("BATCH", "BATCH_PIXELS", "BYTES", "CACHED", "TIMEOUT", "WAITING", "WORK")


def changes(node):
    """
    What may stand in the place of a node.

    Parameters
    ----------
    node : `ast.AST`

    Returns
    -------
    list of `ast.AST`
    """

    def with_(**fields):
        other = copy.copy(node)
        other.__dict__.update(fields)
        return other

    def left_out(items, k):
        return [item for i, item in enumerate(items) if i != k]

    match node:
        case ast.Compare():
            return [
                with_(ops=[*node.ops[:k], other(), *node.ops[k + 1 :]])
                for k, op in enumerate(node.ops)
                for other in COMPARISONS[type(op)]
            ]
        case (
            ast.BinOp(left=ast.Constant(value=str())) | ast.BinOp(left=ast.JoinedStr())
        ):
            return []
        case ast.BinOp(right=ast.Attribute(attr="one")):
            return []  # a unit of nothing
        case ast.BinOp() | ast.BoolOp() | ast.AugAssign() if type(node.op) in OPERATORS:
            return [with_(op=OPERATORS[type(node.op)]())]
        case ast.UnaryOp():
            return [node.operand]
        case ast.Constant(value=bool()):
            return [with_(value=not node.value)]
        case ast.Constant(value=int() | float()):
            return [with_(value=node.value + 1), with_(value=node.value - 1)]
        case ast.Call():
            found = [
                with_(keywords=left_out(node.keywords, k))
                for k, word in enumerate(node.keywords)
                # zip(strict=True) only asserts.
                if word.arg not in (None, "strict")
            ]
            name = getattr(node.func, "id", getattr(node.func, "attr", None))
            starred = any(isinstance(arg, ast.Starred) for arg in node.args)
            if len(node.args) > 1 and not starred and name not in SYMMETRIC:
                *first, a, b = node.args
                found.append(with_(args=[*first, b, a]))
            match node.func:
                case ast.Name() if name in BUILTINS:
                    found.append(with_(func=ast.Name(BUILTINS[name])))
                case ast.Attribute(value=of) if name in METHODS:
                    found.append(with_(func=ast.Attribute(of, METHODS[name])))
            return found
        case ast.Return(value=ast.expr() as value) if not isinstance(
            value, ast.Constant
        ):
            return [with_(value=ast.Constant(None))]
        case ast.Slice():
            lower = None if node.lower else ast.Constant(1)
            upper = None if node.upper else ast.Constant(-1)
            found = [with_(lower=lower), with_(upper=upper)]
            return found + ([with_(step=None)] if node.step else [])
        case ast.If() | ast.While() | ast.IfExp() if not isinstance(
            node.test, ast.Compare | ast.BoolOp | ast.UnaryOp
        ):
            return [with_(test=ast.UnaryOp(ast.Not(), node.test))]
        case ast.Break():
            return [ast.Continue()]
        case ast.Continue():
            return [ast.Break()]
        case ast.Expr(value=ast.Call()):
            return [ast.Pass()]
    return []


def left_alone(node):
    """
    Whether nothing in a node is changed.

    Parameters
    ----------
    node : `ast.AST`

    Returns
    -------
    bool
    """
    match node:
        case ast.Raise() | ast.JoinedStr() | ast.Import() | ast.ImportFrom():
            return True
        case ast.FunctionDef(name="__repr__" | "__str__"):
            return True
        case ast.Expr(value=ast.Constant()):
            return True
        case ast.Assign(targets=[ast.Name(id="__all__")]):
            return True
        case ast.Assign():
            names = (n.id for n in ast.walk(node) if isinstance(n, ast.Name))
            return any(name.isupper() and name.endswith(EFFORT) for name in names)
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.Expr(
            value=ast.Call(func=ast.Attribute(value=ast.Name(id="warnings")))
        ):
            return True
    return False


def candidates(clone, path):
    """
    All mutants of a module.

    Parameters
    ----------
    clone : path
    path : str

    Returns
    -------
    list of `Mutant`
    """
    text = (clone / path).read_text()
    tree = ast.parse(text)
    rows = text.splitlines()
    numbers = {id(node): k for k, node in enumerate(ast.walk(tree))}
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]
    bodies = [_lines(f.body[0].lineno, f.end_lineno) for f in functions]
    everything = sorted(set().union(*bodies)) if bodies else []
    found = []

    def visit(node, scopes):
        if left_alone(node):
            return
        if isinstance(node, ast.stmt):
            scopes = [_own_lines(node), *scopes[-2:]]
        if isinstance(node, ast.Assign | ast.AnnAssign) and len(scopes) == 2:
            # A constant of the module is used elsewhere.
            names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
            users = (
                body
                for f, body in zip(functions, bodies, strict=True)
                if names & {n.id for n in ast.walk(f) if isinstance(n, ast.Name)}
            )
            scopes = [sorted(set().union(*users)), everything]
        for variant, other in enumerate(changes(node)):
            first = node.test if isinstance(node, ast.If | ast.While) else node
            before, after = _short(node), _short(other)
            if before == after:
                continue
            row = rows[first.lineno - 1].strip()
            place = numbers[id(node)], variant, first.lineno, row
            found.append(Mutant(path, *place, before, after, scopes))
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            inside = scopes
            if isinstance(node, ast.FunctionDef):
                # Defaults as well are what the body is tested with.
                own = _lines(node.body[0].lineno, node.end_lineno)
                inside = [own, own, everything]
            if isinstance(node, ast.arguments) and name in ("defaults", "kw_defaults"):
                value = _that_matter(node, name)
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    visit(child, inside)

    for statement in tree.body:
        visit(statement, [everything])
    return found


def _that_matter(arguments, name):
    """Defaults without that of a number of trials, which any number will do for."""
    values = getattr(arguments, name)
    if name == "defaults":
        named = (arguments.posonlyargs + arguments.args)[-len(values) or None :]
    else:
        named = arguments.kwonlyargs
    pairs = zip(named, values, strict=False)
    return [value for arg, value in pairs if arg.arg != "n_trials"]


def _lines(first, last):
    return list(range(first, last + 1))


def _own_lines(statement):
    """Lines of a statement without those in its body."""
    body = getattr(statement, "body", None)
    last = body[0].lineno - 1 if body else statement.end_lineno
    return _lines(statement.lineno, max(last, statement.lineno))


def _short(node):
    if isinstance(node, ast.If | ast.While):
        return f"if {ast.unparse(node.test)}"
    if isinstance(node, ast.Slice):
        return f"[{ast.unparse(node)}]"
    return " ".join(ast.unparse(node).split())


def draw(clone, room, number, seed):
    """
    Mutants of a room, each as likely as any other.

    Parameters
    ----------
    clone : path
    room : str
    number, seed : int

    Returns
    -------
    list of `Mutant`
    """
    files = sorted((clone / "astro_scc" / room).rglob("*.py"))
    every = [m for f in files for m in candidates(clone, str(f.relative_to(clone)))]
    rng = random.Random(f"{room} {seed}")
    return rng.sample(every, min(number, len(every)))


def mutated(text, mutant):
    """
    The source of a module with one expression changed.

    Parameters
    ----------
    text : str
    mutant : `Mutant`

    Returns
    -------
    str
    """
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))
    old = nodes[mutant.node]
    new = changes(old)[mutant.variant]
    for parent in nodes:
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
            elif isinstance(value, list):
                value[:] = [new if item is old else item for item in value]
    return ast.unparse(ast.fix_missing_locations(tree))


# -- to run them ---------------------------------------------------------------------


def warm_up(clone):
    """
    Import what the package imports, but for the package, once for all mutants.

    Parameters
    ----------
    clone : path
    """
    script = (
        "import sys, pkgutil, importlib, astro_scc\n"
        "for m in pkgutil.walk_packages(astro_scc.__path__, 'astro_scc.'):\n"
        "    if not m.name.endswith('__main__'): importlib.import_module(m.name)\n"
        "print(*sys.modules, sep='\\n')\n"
    )
    command = [sys.executable, "-W", "ignore", "-c", script]
    found = subprocess.run(
        command, cwd=clone, capture_output=True, text=True, check=True
    )
    more = ["hypothesis", "pytest_cov.plugin", "matplotlib.backends.backend_agg"]
    for name in [*found.stdout.split(), *more]:
        if name.split(".")[0] not in ("astro_scc", "__main__"):
            with contextlib.suppress(Exception):
                importlib.import_module(name)


def judge(mutant, clone, tests, budget):
    """
    Run the tests of a mutant.

    Parameters
    ----------
    mutant : `Mutant`
    clone : path
    tests : `Tests`
    budget : float

    Returns
    -------
    {"killed", "time", "survived"}
    """
    path = clone / mutant.path
    text = path.read_text()
    cached = Path(importlib.util.cache_from_source(str(path)))
    try:
        # Nobody may take the bytecode of one for that of another.
        cached.unlink(missing_ok=True)
        path.write_text(mutated(text, mutant) + "\n")
        for names in tests.plan(mutant, budget):
            usual = sum(tests.durations[name] for name in names)
            log, limit = clone.parent / "last.log", SLOWER * usual + GRACE
            status = in_fork(lambda n=names: attempt(clone, n), log, limit)
            if status is None:
                return "time"
            if status == pytest.ExitCode.NO_TESTS_COLLECTED:
                raise RuntimeError(f"{mutant}: its tests are gone, record them again")
            if status != 0:
                return "killed"
    finally:
        path.write_text(text)
    return "survived"


def attempt(clone, names):
    """
    Run chosen tests until one fails.

    Parameters
    ----------
    clone : path
    names : list of str

    Returns
    -------
    int
    """
    order = {name: k for k, name in enumerate(names)}

    class Chosen:
        @pytest.hookimpl(trylast=True)
        def pytest_collection_modifyitems(self, items):
            items[:] = [item for item in items if item.nodeid in order]
            items.sort(key=lambda item: order[item.nodeid])

    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    # Modules that are collected for doctests first would be there twice.
    files = {name.split("::")[0] for name in names}
    files = sorted(files, key=lambda file: (not file.startswith("tests"), file))
    # That hypothesis is here already.
    quiet = ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    return run_pytest(clone, ["-x", "--no-cov", *quiet, *files], [Chosen()])


def in_fork(function, log, limit):
    """
    Call a function in a process of its own.

    Parameters
    ----------
    function : callable
        Its result is the status.
    log : path
        For what it prints.
    limit : float or None
        Seconds, after which the process and its children are ended.

    Returns
    -------
    int or None
        None if it took too long.
    """
    child = os.fork()
    if child == 0:
        status = 70
        try:
            os.setsid()
            with open(log, "wb") as file:
                for stream in (1, 2):
                    os.dup2(file.fileno(), stream)
            status = function()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    end = None if limit is None else time.monotonic() + limit
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            result = os.waitstatus_to_exitcode(status)
            break
        if end is not None and time.monotonic() > end:
            result = None
            break
        time.sleep(0.02)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if not done:
        os.waitpid(child, 0)
    return result


if __name__ == "__main__":
    main()
