"""Files of arrays that are checked whole before anything of them is used.

A file is a ZIP archive without compression, as ``numpy.savez`` writes it: a block NAME.npy for each array, and
``manifest.json``, which says what the file is and names each block with its length and CRC-32. ``numpy.load`` opens it.
"""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcollide.errors import CheckpointError
from fastcollide.files import written_durably

FORMAT = "fastcollide world"
VERSION = 2  # 2: what rough contacts remember
READABLE = (1, 2)
IDS = ("contact_owner", "contact_partner")  # the arrays that hold ids; all others hold float32
MANIFEST = "manifest.json"
# What zipfile raises, one way or the other, where an archive is not as it must be.
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    struct.error,
    EOFError,
    NotImplementedError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
)


@dataclass(frozen=True)
class Archive:
    """A file that has been read and checked. contents: what the manifest says beside the blocks."""

    path: Path
    contents: dict[str, Any]
    arrays: dict[str, NDArray[np.float32 | np.uint32]]


def write_archive(path: str | os.PathLike[str], contents: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Writes a file; under its name it is whole or not there at all, and it is on the disk when this returns.

    contents: values of JSON; arrays: float32, uint32 for ids. Raises OSError where the file cannot be written.
    """
    blocks: dict[str, dict[str, int]] = {}
    with written_durably(Path(path)) as unfinished, zipfile.ZipFile(unfinished, "w") as archive:
        for name, array in arrays.items():
            block = BytesIO()
            np.lib.format.write_array(block, np.asarray(array, dtype=_dtype_of(name), order="C"), allow_pickle=False)
            blocks[f"{name}.npy"] = _measure(block.getbuffer())
            _add_block(archive, f"{name}.npy", block.getbuffer())
        manifest = {"format": FORMAT, "version": VERSION, **contents, "blocks": blocks}
        _add_block(archive, MANIFEST, json.dumps(manifest, indent=1, ensure_ascii=False, default=_plain).encode())


def read_archive(path: str | os.PathLike[str]) -> Archive:
    """Reads a file and checks all of it: kind, version, and the length and checksum of each block.

    Raises CheckpointError where it is not such a file or is damaged, OSError where it cannot be read.
    """
    path = Path(path)
    with path.open("rb") as file:
        try:
            archive = zipfile.ZipFile(file)
        except _ZIP_ERRORS as error:
            raise CheckpointError(path, None, f"no whole archive ({error})", "a file of World.save") from None
        with archive:
            manifest = _read_manifest(path, archive)
            blocks = manifest.pop("blocks")
            found = sorted(set(archive.namelist()) - {MANIFEST})
            if len(archive.namelist()) != len(blocks) + 1 or found != sorted(blocks):
                raise CheckpointError(path, None, f"the blocks {', '.join(found)}", f"{', '.join(sorted(blocks))}")
            arrays = {}
            for block, about in blocks.items():
                content = _read_block(path, archive, block)
                _check_block(path, block, content, about)
                arrays[block.removesuffix(".npy")] = _array_in(path, block, content)
    return Archive(path, manifest, arrays)


def _add_block(archive: zipfile.ZipFile, block: str, content: bytes | memoryview) -> None:
    with archive.open(block, "w", force_zip64=True) as member:  # without a date: equal worlds give equal files
        member.write(content)


def _measure(content: bytes | memoryview) -> dict[str, int]:
    return {"bytes": len(content), "crc32": zlib.crc32(content)}


def _read_manifest(path: Path, archive: zipfile.ZipFile) -> dict[str, Any]:
    if MANIFEST not in archive.namelist():
        raise CheckpointError(path, MANIFEST, "no such block", "a file of World.save")
    try:
        manifest = json.loads(_read_block(path, archive, MANIFEST))
    except (ValueError, RecursionError) as error:
        raise CheckpointError(path, MANIFEST, f"no JSON ({error})", "a file of World.save") from None
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise CheckpointError(path, MANIFEST, "another format", f'"{FORMAT}"')
    if manifest.get("version") not in READABLE:
        found = f"version {manifest.get('version')!r}"
        allowed = f"version {' or '.join(map(str, READABLE))}, all that this FastCollide can read"
        raise CheckpointError(path, MANIFEST, found, allowed)
    if not isinstance(manifest.get("blocks"), dict):
        raise CheckpointError(path, MANIFEST, "no list of blocks", "the length and CRC-32 of each")
    return manifest


def _read_block(path: Path, archive: zipfile.ZipFile, block: str) -> bytes:
    """The bytes of a block, which zipfile checks against its own CRC-32."""
    about = archive.getinfo(block)
    if about.compress_type != zipfile.ZIP_STORED:  # it could unfold to any size
        raise CheckpointError(path, block, "a compressed block", "blocks without compression")
    longest = path.stat().st_size
    if about.file_size > longest or about.compress_size > longest:  # zipfile would make room for it
        raise CheckpointError(path, block, f"a block of {about.file_size} bytes in a file of {longest}", "whole files")
    try:
        return archive.read(block)
    except _ZIP_ERRORS as error:
        raise CheckpointError(path, block, f"a damaged block ({error})", "the bytes that were written") from None


def _check_block(path: Path, block: str, content: bytes, about: Any) -> None:
    found = _measure(content)
    if found != about:
        words = f"{found['bytes']} bytes with the CRC-32 {found['crc32']:08x}"
        raise CheckpointError(path, block, words, f"those that the manifest names: {about}")


def _dtype_of(name: str) -> str:
    return "<u4" if name in IDS else "<f4"


def _array_in(path: Path, block: str, content: bytes) -> NDArray[np.float32 | np.uint32]:
    """The array in a block, without a copy. Its header is looked at first: numpy would make room for any shape."""
    file = BytesIO(content)
    try:
        np.lib.format.read_magic(file)
        shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(file)
        if is_fortran or dtype != np.dtype(_dtype_of(block.removesuffix(".npy"))):
            raise ValueError(f"{dtype}{' in Fortran order' if is_fortran else ''}")
        return np.frombuffer(content, dtype, offset=file.tell()).reshape(shape)
    except ValueError as error:
        raise CheckpointError(path, block, f"no such array ({error})", "float32 numbers in C order") from None


def _plain(value: Any) -> Any:
    """A number of NumPy as one of Python."""
    return value.item()
