"""Tables and numbers as Markdown shows them."""

from collections.abc import Sequence
from typing import NamedTuple

NOT_YET = "(not on record yet)"
"""What stands in a sentence where a number will be."""


class Table(NamedTuple):
    """A table of text; one without rows says so in a sentence."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    if_empty: str = "Nothing is on record yet."


def markdown(table: Table) -> str:
    """A table in Markdown, each of its lines with a line break."""
    if not table.rows:
        return f"{table.if_empty}\n"
    lines = [table.header, ["---"] * len(table.header), *table.rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def without_constant_columns(table: Table, columns: int) -> Table:
    """A table less those of its first columns that say the same in every row."""
    shown = [
        i
        for i in range(len(table.header))
        if i >= columns or len({row[i] for row in table.rows}) > 1
    ]
    rows = [[row[i] for i in shown] for row in table.rows]
    return Table([table.header[i] for i in shown], rows, table.if_empty)


def percent(share: float, decimals: int = 0) -> str:
    """A share in percent, less decimals that are zero."""
    return f"{round(100 * share, decimals):g} %"


def in_words(number: int) -> str:
    """A number as sentences have it: below ten in words."""
    words = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    return words[number] if number < len(words) else str(number)


def counted(number: int, thing: str) -> str:
    """Such as "five seeds"."""
    return f"{in_words(number)} {thing}{'' if number == 1 else 's'}"
