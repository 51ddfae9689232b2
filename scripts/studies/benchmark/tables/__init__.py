"""The numbers as tables, for the terminal and for Markdown; ratios first."""

from studies.benchmark.tables.output import show, to_markdown
from studies.benchmark.tables.table import number

__all__ = ["number", "show", "to_markdown"]
