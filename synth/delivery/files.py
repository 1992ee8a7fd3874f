"""Names and places of exported files: checked before anything is written, then written all or none."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from synth.checks import shown
from synth.errors import ExportError
from synth.files import write_atomically

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
LONGEST = 48  # with `_self_test` still within the 63 significant characters of C99
RESERVED = frozenset(
    # keywords of C99, C11 and C++, because the header may be included there
    "alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl const constexpr "
    "const_cast continue decltype default delete do double dynamic_cast else enum explicit export extern false float "
    "for friend goto if inline int long mutable namespace new noexcept not not_eq nullptr operator or or_eq private "
    "protected public register reinterpret_cast restrict return short signed sizeof static static_assert static_cast "
    "struct switch template this thread_local throw true try typedef typeid typename union unsigned using virtual "
    "void volatile wchar_t while xor xor_eq main "
    # headers of the standard library and of the units, which a file of the same name would hide
    "assert complex ctype errno fenv inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic "
    "stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype "
    "model instance fmi2 fmi3".split()
)


def check_name(name: str) -> str:
    """A name that is safe as a C identifier and as a file's name, or an ExportError."""
    if not isinstance(name, str) or not IDENTIFIER.fullmatch(name):
        raise ExportError(
            f"name is {shown(name)}; it becomes C identifiers and file names: pass letters, digits and underscores, a "
            "letter first, and no folder"
        )
    if name.lower() in RESERVED:
        raise ExportError(
            f"name is {name!r}, a reserved word or standard header of C; pass another, say {name}_control"
        )
    if len(name) > LONGEST:
        raise ExportError(
            f"name has {len(name)} characters; C tells identifiers apart by their first ones: at most {LONGEST}"
        )
    return name


def write_all(folder: str | os.PathLike[str], files: Mapping[str, bytes], *, force: bool) -> tuple[Path, ...]:
    """Write the files into `folder`, which is made if it is missing; all of them or none.

    Raises
    ------
    ExportError : the folder is a file, or a file exists and `force` is not set.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ExportError(f"{folder.name} is no folder; pass the folder that the files go into")
    targets = {folder / name: content for name, content in files.items()}
    for path in targets:
        if path.is_dir():
            raise ExportError(f"{path.name} is a folder; pass another name")
        if path.exists() and not force:
            raise ExportError(f"{path.name} exists; pass force=True to replace it, or another name")
    for path in targets:
        path.parent.mkdir(parents=True, exist_ok=True)
    before = {path: path.read_bytes() if path.exists() else None for path in targets}
    try:
        for path, content in targets.items():
            write_atomically(path, content)
    except BaseException:
        for path, content in before.items():
            if content is None:
                path.unlink(missing_ok=True)
            else:
                write_atomically(path, content)
        raise
    return tuple(targets)
