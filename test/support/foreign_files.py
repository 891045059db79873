"""Files that somebody else could have written, or that are none: what a program wrote for itself is none of them."""

import os


def _link(path, text):
    target = path.with_name("target")
    target.write_text(text)
    path.symlink_to(target)


def _open_to(mode):
    def make(path, text):
        path.write_text(text)
        path.chmod(mode)

    return make


def _long(path, text):
    path.write_text(text + " " * 10**6)


FOREIGN_FILES = {
    "a link": (_link, "it is a link"),
    "a pipe": (lambda path, _text: os.mkfifo(path), "it is no regular file"),
    "a folder": (lambda path, _text: path.mkdir(), "it is no regular file"),
    "writable by the group": (_open_to(0o664), "mode 0664 lets others write"),
    "writable by all": (_open_to(0o646), "mode 0646 lets others write"),
    "too long": (_long, "bytes: must be <= "),
}
"""How each is made from path and text, and a part of the reason for which it is not used."""
