"""Plain files of bounded size are read; writes are atomic; hashes of inputs: an output is whole or absent, and says its source."""

from __future__ import annotations

import codecs
import errno
import hashlib
import io
import math
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from .errors import InputError
from .names import BYTES_SHOWN

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BLOCK_BYTES = 1 << 20
"""Files are read and hashed in pieces of 1 MiB."""
MIB = 1 << 20
"""Bytes: 2^20."""
TOML_BYTES, PYTHON_BYTES, JSON_BYTES = 4 * MIB, 4 * MIB, 256 * MIB
"""Largest files that are read, here and in the next line: far above any of their kind, so that a wrong one is
refused. Choices."""
TABLE_BYTES, PICTURE_BYTES, ARRAY_BYTES = 512 * MIB, 512 * MIB, 1024 * MIB
"""No file of its kind that towline reads is larger; videos may be of any size, they are never held whole."""
ABSENT = "no such file"
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}

# reading -------------------------------------------------------------------------------------------------------------


def refusal(path: str | Path, most: int | None = None) -> str | None:
    """Why ``path`` is nothing to read from ("no such file", "is a named pipe; ..."); None where it is a plain file.

    Parameters
    ----------
    path : of the file
    most : bytes that it may have; None: any number
    """
    try:
        return _unlike_a_file(os.stat(path), most)
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: a zero byte in the name
        return ABSENT
    except OSError as error:
        return ABSENT if error.errno == errno.ENAMETOOLONG else f"cannot be read ({error.strerror})"


def _unlike_a_file(found: os.stat_result, most: int | None) -> str | None:
    if not stat.S_ISREG(found.st_mode):
        return f"is {_KINDS.get(stat.S_IFMT(found.st_mode), 'no file')}; a plain file is expected"
    return None if most is None or found.st_size <= most else _too_large(found.st_size, most)


def _too_large(size: int, most: int) -> str:
    return f"has {size / MIB:.0f} MiB; at most {most // MIB} MiB are read of such a file"


@contextmanager
def reading(path: str | Path, most: int | None = None) -> Iterator[BinaryIO]:
    """A plain file, open for reading: looked at before it is opened (a device may act when it is) and after (it may be another).

    Parameters
    ----------
    path : of the file
    most : bytes that it may have; None: any number

    Raises
    ------
    InputError : it is absent, cannot be opened, is a named pipe, a device, a folder, or too large
    """
    wrong = refusal(path, most)
    if wrong is not None:
        raise InputError(path, "", wrong)
    try:
        # not to wait for a writer where a named pipe has taken the file's place meanwhile
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from None
    with open(handle, "rb") as stream:
        wrong = _unlike_a_file(os.fstat(handle), most)
        if wrong is not None:
            raise InputError(path, "", wrong)
        yield stream


def read_bytes(path: str | Path, most: int) -> bytes:
    """All bytes of a plain file; InputError as ``reading`` has it, or where it grew beyond ``most`` meanwhile.

    Parameters
    ----------
    path : of the file
    most : bytes that it may have
    """
    with reading(path, most) as stream:
        try:
            # block by block: memory for what is there, not for what might be
            content = b"".join(
                block for _, block in zip(range(most // _BLOCK_BYTES + 2), _blocks(stream), strict=False)
            )
        except OSError as error:
            raise InputError(path, "", f"cannot be read ({error.strerror})") from None
    if len(content) > most:
        raise InputError(path, "", _too_large(len(content), most))
    return content


def _blocks(stream: BinaryIO) -> Iterator[bytes]:
    while block := stream.read(_BLOCK_BYTES):
        yield block


def read_text(path: str | Path, most: int) -> str:
    """A plain file of UTF-8 text, without its byte order mark, its lines ended by LF; InputError as ``read_bytes``, or no text.

    Parameters
    ----------
    path : of the file
    most : bytes that it may have
    """
    content = read_bytes(path, most)
    try:
        text = content.removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as error:
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise InputError(path, "", "is not UTF-8 text but UTF-16; save it as UTF-8") from None
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(path, f"line {line}", "is not UTF-8 text; save the file as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def read_array(path: str | Path) -> NDArray[Any]:
    """An array that ``write_array`` wrote; what its header claims is held against the file's size before memory is taken.

    Raises
    ------
    InputError : as ``read_bytes``, it is no array, holds objects, or its header claims another size than the file has
    """
    import numpy as np

    stream = io.BytesIO(read_bytes(path, ARRAY_BYTES))
    try:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ValueError(f"version {version}; (1, 0) is expected")
        shape, _, kind = np.lib.format.read_array_header_1_0(stream)
        claimed, there = math.prod((kind.itemsize, *shape)), stream.getbuffer().nbytes - stream.tell()
        if claimed != there:
            raise ValueError(f"its header claims {claimed} bytes of numbers, {there} follow it")
        stream.seek(0)
        return np.load(stream, allow_pickle=False)
    except MemoryError:
        raise
    except Exception as error:  # of damaged headers: whatever came of it
        raise InputError(path, "", f"is no array that can be read: {' '.join(str(error).split())[:200]}") from None


# writing -------------------------------------------------------------------------------------------------------------


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


_UMASK = _umask()
"""Asked for once: to ask is to set it for a moment, and other threads make files, too."""


@contextmanager
def replacing(path: str | Path, lasting: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; rename it to ``path`` when the block ends without an error.

    The temporary file keeps the suffix of ``path`` (encoders choose their container by it), is nobody else's to read, and is
    removed on failure. A file that is replaced hands its permissions on. A link is replaced by the file, never written through.

    Parameters
    ----------
    path : of the file
    lasting : it survives a power cut from here on; for what nothing can work out again
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=f".tmp{target.suffix}", dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        if lasting:
            _to_disk(temporary, os.O_RDWR)
        os.chmod(temporary, _mode(target))
        os.replace(temporary, target)
        if lasting:
            name_on_disk(target)
    except OSError as error:
        raise _of_the_target(error, temporary, target) from None
    finally:
        temporary.unlink(missing_ok=True)


def _mode(target: Path) -> int:
    """Permissions of the file that is there, or those of a new one."""
    try:
        return stat.S_IMODE(target.stat().st_mode) & 0o777
    except OSError:
        return 0o666 & ~_UMASK


def name_on_disk(path: Path) -> None:
    """A file that is new, or was renamed, is found under its name after a power cut.

    Parameters
    ----------
    path : of the file
    """
    with suppress(OSError):  # a folder cannot be opened everywhere
        _to_disk(path.parent, os.O_RDONLY)


def _to_disk(path: Path, how: int) -> None:
    handle = os.open(path, how)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _of_the_target(error: OSError, temporary: Path, target: Path) -> OSError:
    """The error with the name of the file that could not be written; another file's keeps its own."""
    if error.filename not in (None, str(temporary), temporary):
        return error
    return OSError(error.errno, error.strerror or str(error) or "cannot be written", str(target))


def write_text(path: str | Path, text: str, lasting: bool = False) -> None:
    """Write ``text`` as UTF-8 atomically.

    Parameters
    ----------
    path : of the file
    text : what is written
    lasting : as for ``replacing``
    """
    with replacing(path, lasting) as temporary:
        temporary.write_text(text, encoding="utf-8", errors=BYTES_SHOWN, newline="\n")


def write_array(path: str | Path, array: NDArray[Any]) -> None:
    """Write numbers as .npy atomically; by Python's own writing, which says why where the disk is full.

    Parameters
    ----------
    path : of the file
    array : numbers
    """
    import numpy as np

    content = io.BytesIO()
    np.save(content, array, allow_pickle=False)
    # bytes, not a view of them: where an error held that, early versions of Python 3.12 crashed as they ended
    with replacing(path) as temporary:
        temporary.write_bytes(content.getvalue())


# hashes --------------------------------------------------------------------------------------------------------------


def sha256_of_file(path: str | Path) -> str:
    """Return the hexadecimal SHA-256 of a plain file's bytes, however many; InputError as ``reading``."""
    digest = hashlib.sha256()
    with reading(path) as stream:
        for block in _blocks(stream):
            digest.update(block)
    return digest.hexdigest()


def sha256_of_texts(*texts: str) -> str:
    """Return the hexadecimal SHA-256 of some texts, each ended by a zero byte so that they cannot run together."""
    digest = hashlib.sha256()
    for text in texts:
        digest.update(text.encode("utf-8", "surrogatepass") + b"\0")
    return digest.hexdigest()
