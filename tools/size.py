# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Show the size of the package: code lines, files and exported names of each subpackage.

With images, show how many functions and files a measurement of them runs through::

    python tools/size.py
    python tools/size.py --way ../shared/data/0003+380/*.fits
"""

import argparse
import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "astro_scc"
NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT,
    tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def code_lines(source):
    """Return the number of lines without docstrings, comments and blank lines."""
    docstrings = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            first = node.body[0]
            docstrings.update(range(first.lineno, first.end_lineno + 1))
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def exported(source):
    """Return the number of names in ``__all__``."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and node.targets[0].id == "__all__":
            return len(ast.literal_eval(node.value))
    return 0


def rooms():
    """Print the table of rooms."""
    lines, files, names = Counter(), Counter(), Counter()
    for path in PACKAGE.rglob("*.py"):
        if path.name == "_version.py":
            # It is made when the package is built.
            continue
        room = path.relative_to(PACKAGE).parts[0]
        source = path.read_text(encoding="utf-8")
        lines[room] += code_lines(source)
        files[room] += 1
        if path.name == "__init__.py":
            names[room] += exported(source)
    print(f"{'room':20}{'code lines':>12}{'files':>8}{'names':>8}")
    for room, number in lines.most_common():
        print(f"{room:20}{number:12}{files[room]:8}{names[room]:8}")
    total = (sum(counter.values()) for counter in (lines, files, names))
    print("{:20}{:12}{:8}{:8}".format("all", *total))


def way(paths):
    """Print the numbers of functions and files between FITS files and components."""
    from astro_scc import EpochCube, StackedCrossCorrelation

    seen = set()

    def note(frame, event, _):
        code = frame.f_code
        # Count neither modules nor comprehensions.
        named = not code.co_name.startswith("<")
        if event == "call" and named and code.co_filename.startswith(str(PACKAGE)):
            seen.add((code.co_filename, code.co_qualname))

    sys.setprofile(note)
    cube = EpochCube.read(paths).to_common_beam().align("core")
    _ = StackedCrossCorrelation()(cube, n_trials=19, rng=1).components
    sys.setprofile(None)
    print(f"{len(seen)} functions in {len({file for file, _ in seen})} files")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--way", nargs="+", metavar="FITS")
    args = parser.parse_args()
    if args.way:
        way(args.way)
    else:
        rooms()
