"""Names and places of exported files: checked before anything is written, then written all or none."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from synth.checks import shown
from synth.errors import ExportError, ModelError
from synth.files import check_writable, is_device, write_atomically

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
    if is_device(name):
        raise ExportError(f"name is {name!r}, which Windows takes for a device; pass another, say {name}_control")
    if len(name) > LONGEST:
        raise ExportError(
            f"name has {len(name)} characters; C tells identifiers apart by their first ones: at most {LONGEST}"
        )
    return name


def check_target(target: Path, what: str, endings: tuple[str, ...], *, force: bool) -> None:
    """Raise before the work is done for a file that could not be written, or must not be.

    Raises
    ------
    ModelError : its name ends otherwise or is a device, it is a folder, its folder does not exist or cannot be written,
        or it exists and `force` is not set.
    """
    if target.suffix not in endings:
        raise ModelError(f"{target}: {what} is saved as {' or '.join(endings)}")
    if is_device(target.name):
        raise ModelError(f"{target}: Windows takes this name for a device; choose another")
    if target.is_dir() or not target.parent.is_dir():
        raise ModelError(f"{target}: {'this is a folder' if target.is_dir() else 'its folder does not exist'}")
    if target.exists() and not force:
        raise ModelError(f"{target}: the file exists; pass --force to replace it, or another -o")
    try:
        check_writable(target.parent)
    except OSError as error:
        raise ModelError(f"{target}: its folder cannot be written ({error.strerror})") from None


def made(folder: Path) -> Path:
    """The folder, made if it is missing and tried by writing.

    Raises
    ------
    ExportError : it is a file, or cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        check_writable(folder)
    except OSError as error:
        if folder.exists() and not folder.is_dir():
            raise ExportError(f"{folder.name} is no folder; pass the folder that the files go into") from None
        raise ExportError(f"{folder}: files cannot be written there ({error.strerror}); pass another folder") from None
    return folder


def write_all(folder: str | os.PathLike[str], files: Mapping[str, bytes], *, force: bool) -> tuple[Path, ...]:
    """Write the files into `folder`, which is made if it is missing; all of them or none.

    Raises
    ------
    ExportError : the folder is a file or cannot be written, or a file exists and `force` is not set.
    """
    folder = made(Path(folder))
    targets = {folder / name: content for name, content in files.items()}
    for path in targets:
        if path.is_dir():
            raise ExportError(f"{path.name} is a folder; pass another name")
        if path.exists() and not force:
            raise ExportError(f"{path.name} exists; pass force=True to replace it, or another name")
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
