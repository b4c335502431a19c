"""The numbers of README.md, made from committed records.

A table stands between `<!-- table: KIND ARGUMENTS -->` and `<!-- end -->`, on lines of their own; a
number in a sentence between `<!-- value: KIND ARGUMENTS -->` and `<!-- end -->`. The kinds are the
functions of `report_tables.py` and `report_values.py` in the rooms. Between `<!-- screens -->` and
`<!-- end of screens -->` stand files of `screens/`, each the screen of a question of which there
is a record. `python -m experiments.run --report` writes all of it anew, and a test fails where
README.md differs from what the records say.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from experiments.learning import report_tables, report_values
from experiments.learning.plans import read_plans
from experiments.learning.records import recorded_runs
from experiments.markdown import Table, markdown
from experiments.other_programs import report_tables as other_programs
from experiments.physics import report_tables as physics

README = Path(__file__).parent / "README.md"
SCREENS_OF_QUESTIONS = Path(__file__).parent / "screens"
TABLES: Mapping[str, Callable[..., Table]] = {
    **report_tables.TABLES,
    **physics.TABLES,
    **other_programs.TABLES,
}
VALUES: Mapping[str, Callable[..., str]] = {
    **report_values.VALUES,
    **physics.VALUES,
    **other_programs.VALUES,
}

TABLE = re.compile(r"^<!-- table: (.+?) -->\n.*?^<!-- end -->$", re.DOTALL | re.MULTILINE)
VALUE = re.compile(r"<!-- value: (.+?) -->.*?<!-- end -->", re.DOTALL)
SCREENS = re.compile(r"^<!-- screens -->\n.*?^<!-- end of screens -->$", re.DOTALL | re.MULTILINE)


def regenerated(text: str) -> str:
    """The report with all screens, tables and numbers as the records have them.

    Raises:
        ValueError: a marker that is not understood, or a number at the beginning of a line, which
            Markdown would take for a block of HTML.
    """
    text = SCREENS.sub(lambda _: f"<!-- screens -->\n\n{screens()}<!-- end of screens -->", text)
    if re.search(r"^<!-- value", text, re.MULTILINE):
        raise ValueError("README.md: a line begins with a value; put a word before it")

    def table(match: re.Match[str]) -> str:
        return f"<!-- table: {match[1]} -->\n\n{markdown(_made(TABLES, match[1]))}\n<!-- end -->"

    def value(match: re.Match[str]) -> str:
        return f"<!-- value: {match[1]} -->{_made(VALUES, match[1])}<!-- end -->"

    return VALUE.sub(value, TABLE.sub(table, text))


def screens() -> str:
    """The screens of questions that have a file of their own and a record."""
    files = {name: SCREENS_OF_QUESTIONS / f"{name}.md" for name in read_plans().questions}
    return "".join(
        f"{path.read_text()}\n" for name, path in files.items() if path.is_file() and answered(name)
    )


def answered(question: str) -> bool:
    """Whether there is a record of a sweep that is trained for this question alone."""
    questions = read_plans().questions
    others = {sweep for name in questions if name != question for sweep in questions[name].sweeps}
    own = (sweep for sweep in questions[question].sweeps if sweep not in others)
    return any(recorded_runs(sweep) for sweep in own)


def _made(kinds: Mapping[str, Callable[..., Any]], marker: str) -> Any:
    kind, *arguments = marker.split()
    if kind not in kinds:
        raise ValueError(f"README.md: there is no {kind!r}; there are {', '.join(kinds)}")
    return kinds[kind](*arguments)
