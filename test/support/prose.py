"""Markdown as sentences and pictures, for the tests of what readers see."""

import re


def without_fenced_code(text):
    """Return a page without its fenced blocks of code."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def sentences(text):
    """Return the sentences of a page: of paragraphs, items and cells; code blocks and addresses are left out."""
    text = without_fenced_code(text)
    lines = ["" if line.startswith(("    ", "#", "|--", "<!--")) else line for line in text.splitlines()]
    # Each item and each cell is a paragraph of its own.
    text = "\n".join(re.sub(r"^\s*(?:[-*]|\d+\.) ", "\n", line.replace("|", "\n\n")) for line in lines)
    text = re.sub(r"`[^`]*`", "CODE", re.sub(r"\]\([^)]*\)", "]", text))
    parts = [part for paragraph in re.split(r"\n\s*\n", text) for part in re.split(r"(?<=[.!?])\s+", paragraph)]
    return [" ".join(part.split()) for part in parts if part.strip()]


def alone_standing_pictures(text):
    """Return the pictures of a page without a text of at least three words, or without a caption in italics below."""
    found = re.findall(r"^!\[([^\]]*)\]\(([^)]+)\)[^\n]*\n{0,2}(.?)", text, re.MULTILINE)
    return [name for words, name, after in found if len(words.split()) < 3 or after != "*"]


def words(text):
    """Return the words of a page's prose: headings, paragraphs and items, without tables, code and comments."""
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"^::: .*\n(?: .*\n|\n)*", "", text, flags=re.MULTILINE)
    lines = [line for line in without_fenced_code(text).splitlines() if not line.startswith(("    ", "|"))]
    return re.sub(r"\]\([^)]*\)", "]", "\n".join(lines)).split()
