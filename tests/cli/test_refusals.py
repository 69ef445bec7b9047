# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What users get wrong is one line, with status 2, and nothing is written."""

import shlex

import pytest

#: Beside ``tools/inputs.py``, by the beginning of a command: further words, and a part
#: of what is said.
REFUSED = {
    "measure JET -o out": """
--scales "0.01 mas" | scale 0.01 mas is 0.1 px
--baseline "5 6 yr" | no two epochs are 5 to 6 yr apart
--beam "10 arcsec" | mas at 0.0 deg, is larger than the image; give another
--max-speed -2mas/yr | '-2mas/yr' must be finite and above 0
--align coer | --align 'coer' is none of
--region no.reg | no.reg: No such file or directory
--config no.toml | no.toml: No such file or directory
-o full | full: exists and is not empty
""",
    "measure": """
-o out | no epochs were given
""",
    "profile JET -o out": """
| --bins is missing
--bins "1 mas" | 2 distance
""",
    "track -o out": """
| no epochs were given
model.mod --beam "1 mas" | model.mod: no DATE-OBS in the header, or no date in a name
""",
    "inspect": """
| no epochs were given; name the FITS files
JET --speed fast | --speed 'fast' has 'fast' where a number is expected; it must be an
note.fits more.fits | (and 1 more like it)
""",
    "simulate": """
static x --dense | --dense is for two-fluid, not for static
jet x --motion -1 | error: --motion must be zero or positive
jet x --distribution flat | error: --distribution = 'flat' must
static . | .: exists and is not empty
""",
    'restore MODELS -o out --beam "1 mas" --pixel "0.1 mas"': """
--beam "1 mas 2 mas 0 deg" | 2 mas 0 deg' is no beam: a beam is finite with major
--after 2011-01-01 | no component is left
""",
    'restore MODELS -o out --beam "1 mas 0.5 mas 3 deg"': """
--pixel "0.6 mas" | a pixel of 0.6 mas is larger than the beam of 0.5 mas; give a fifth
""",
    "restore MODELS": """
-o out | error: --pixel must be given to make images (--list makes none)
--pixel "0.1 mas" | error: -o must be given to make images
--beam "1 mas" | error: -o and --pixel must be given to make images
""",
    "restore -o out MODELS": """
--pixel "0.1 mas" | 3c1_2006-03-09.mod: is a list of
""",
}
FILES = {
    "file": "mine",
    "full/mine.txt": "mine",
    "note.fits": "no image",
    "more.fits": "no image",
    **dict.fromkeys(
        ("3c1_2006-03-09.mod", "3c1_2007-03-09.mod", "model.mod"),
        "1.0v 0.0v 0v 0.2v 1 0 1\n0.3v 2.0v 45v 0.5v 1 0 1\n",
    ),
}


def cases():
    for command, rows in REFUSED.items():
        for row in rows.strip().splitlines():
            options, _, reason = row.rpartition("| ")
            # Images are read, and the cases of measure are many.
            slow = pytest.mark.slow if command == "measure JET -o out" else ()
            yield pytest.param(f"{command} {options}", reason, marks=slow)


@pytest.mark.parametrize(("command", "reason"), list(cases()))
def test_what_a_user_gets_wrong(jet, refused, here, command, reason):
    for name, text in FILES.items():
        (here / name).parent.mkdir(exist_ok=True)
        (here / name).write_text(text)
    files = {"JET": jet, "MODELS": sorted(here.glob("3c1*"))}
    words = (files.get(word, [word]) for word in shlex.split(command))
    assert reason in refused(*(word for own in words for word in own))
