"""Tables of docs/performance.md that come straight from results.

A table is between `<!-- table: SECTION NAME -->` and `<!-- end -->`. Columns follow after a colon,
`<!-- table: SECTION NAME: column, column -->`; all without it. What is between is replaced, and the
text around it stays.
"""

import re
from pathlib import Path

from benchmarks.history import Results
from benchmarks.tables import markdown

PAGE = Path(__file__).parents[1] / "docs" / "performance.md"
MARKED = re.compile(r"(<!-- table: (\w+) (\w+)(?:: (.*?))? -->\n).*?(\n<!-- end -->)", re.DOTALL)


def rewritten(text: str, results: Results) -> str:
    """Return a page with its tables written from results.

    Raises:
        ValueError: the results lack a table or column of it.
    """

    def written(found: re.Match[str]) -> str:
        opening, section, name, chosen, closing = found.groups()
        rows = results["sections"].get(section, {}).get(name)
        if not rows:
            raise ValueError(f"the results of {results['commit']} have no table {section} {name}")
        columns = [each.strip() for each in chosen.split(",")] if chosen else []
        missing = [each for each in columns if not any(each in row for row in rows)]
        if missing:
            raise ValueError(f"table {section} {name} has no columns {', '.join(missing)}")
        return f"{opening}\n{markdown(rows, columns)}\n{closing}"

    return MARKED.sub(written, text)
