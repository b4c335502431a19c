"""The numbers of README.md, made from committed records.

A table stands between `<!-- table: KIND ARGUMENTS -->` and `<!-- end -->`, on lines of their own; a
number in a sentence between `<!-- value: KIND ARGUMENTS -->` and `<!-- end -->`. The kinds are the
functions of `report_tables.py` and `report_values.py` in the rooms. `python -m experiments.run
--report` writes them anew, and a test fails where README.md differs from what the records say.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from experiments.learning import report_tables, report_values
from experiments.markdown import Table, markdown
from experiments.physics import report_tables as physics

README = Path(__file__).parent / "README.md"
TABLES: Mapping[str, Callable[..., Table]] = {**report_tables.TABLES, **physics.TABLES}
VALUES: Mapping[str, Callable[..., str]] = {**report_values.VALUES, **physics.VALUES}

TABLE = re.compile(r"^<!-- table: (.+?) -->\n.*?^<!-- end -->$", re.DOTALL | re.MULTILINE)
VALUE = re.compile(r"<!-- value: (.+?) -->.*?<!-- end -->", re.DOTALL)


def regenerated(text: str) -> str:
    """The report with all tables and numbers as the records have them.

    Raises:
        ValueError: a marker that is not understood, or a number at the beginning of a line, which
            Markdown would take for a block of HTML.
    """
    if re.search(r"^<!-- value", text, re.MULTILINE):
        raise ValueError("README.md: a line begins with a value; put a word before it")

    def table(match: re.Match[str]) -> str:
        return f"<!-- table: {match[1]} -->\n\n{markdown(_made(TABLES, match[1]))}\n<!-- end -->"

    def value(match: re.Match[str]) -> str:
        return f"<!-- value: {match[1]} -->{_made(VALUES, match[1])}<!-- end -->"

    return VALUE.sub(value, TABLE.sub(table, text))


def _made(kinds: Mapping[str, Callable[..., Any]], marker: str) -> Any:
    kind, *arguments = marker.split()
    if kind not in kinds:
        raise ValueError(f"README.md: there is no {kind!r}; there are {', '.join(kinds)}")
    return kinds[kind](*arguments)
