"""Markdown tables as their cells, and cells against numbers."""


def tables(text):
    """Return the tables of a page, each a list of rows of cells; the first row is the head."""
    found, rows = [], []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.replace("\\|", "\0").strip("|").split("|")])
        elif rows:
            head, rule, *body = rows
            assert set("".join(rule)) == {"-"}, rule
            assert {len(row) for row in body} <= {len(head)}, head
            found.append([head, *body])
            rows = []
    return found


def shows(cell, value):
    """True if a cell shows a number rounded to its digits, or ``-`` for None."""
    if value is None or cell == "-":
        return value is None and cell == "-"
    text = cell.removesuffix("%").strip()
    digits = len(text.partition(".")[2])
    return abs(float(text) - value) <= 0.5000001 * 10.0**-digits


def assert_shows(cells, values):
    """Compare a row's cells with the numbers that they have to show."""
    assert len(cells) == len(values), (cells, values)
    wrong = [(index, *pair) for index, pair in enumerate(zip(cells, values, strict=True)) if not shows(*pair)]
    assert not wrong, wrong
