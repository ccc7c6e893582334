# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Search for bags in folders and by patterns, and the names of their results."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from plane_detector.tools.replay.bag_reader import FILE_SUFFIXES, BagError


def is_collection(text: str) -> bool:
    """Whether a path is a pattern, or a folder of bags that is not a bag itself."""
    if not os.path.lexists(text):
        return glob.has_magic(text)
    path = Path(text)
    return path.is_dir() and not _is_bag_folder(path) and any(_below(path, None))


def find_bags(inputs: Sequence[str], left_out: Path | None = None) -> dict[str, Path]:
    """
    Return the bags to process, by the names of the new ones.

    Parameters
    ----------
    inputs : sequence of str
        Bags; folders, which are searched recursively; patterns.
    left_out : Path, optional
        A folder that is not searched: that of the new bags.

    Returns
    -------
    dict of str to Path
        In a fixed order. A bag given as such keeps its name; one found in a folder is named by its
        path in the folder: ``monday_walk`` for ``monday/walk``.

    Raises
    ------
    FileNotFoundError
        A path does not exist, or a folder contains no bag.
    BagError
        Two new bags would have the same name.

    """
    named: dict[str, Path] = {}
    for text in inputs:
        found = list(_of_input(text, left_out))
        if not found:
            raise FileNotFoundError(f'there is no bag {"in" if Path(text).is_dir() else "at"} '
                                    f'{text}')
        for name, path in found:
            if named.setdefault(name, path).resolve() != path.resolve():
                raise BagError(f'{named[name]} and {path} would both become {name}: process them '
                               'in two runs, with two folders')
    return named


def _of_input(text: str, left_out: Path | None) -> Iterable[tuple[str, Path]]:
    if os.path.lexists(text):
        paths = [Path(text)]
    else:
        paths = [Path(match) for match in sorted(glob.glob(text, recursive=True))]
        paths = [path for path in paths if path.is_dir() or path.suffix in FILE_SUFFIXES]
    for path in paths:
        if path.is_dir() and not _is_bag_folder(path):
            yield from (('_'.join(bag.relative_to(path).with_suffix('').parts), bag)
                        for bag in _below(path, left_out))
        else:
            yield path.stem, path


def _below(folder: Path, left_out: Path | None) -> Iterable[Path]:
    """Yield the bags in a folder and its subfolders, sorted by name."""
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            if _is_bag_folder(path):
                yield path
            elif path.suffix != '.part' and not (left_out and path.resolve() == left_out):
                yield from _below(path, left_out)
        elif path.suffix in FILE_SUFFIXES:
            yield path


def _is_bag_folder(path: Path) -> bool:
    """Whether it has metadata, or is a killed recording, a single storage file."""
    if (path / 'metadata.yaml').exists():
        return True
    entries = list(path.iterdir())
    storages = [entry for entry in entries if entry.suffix in ('.mcap', '.db3')]
    return len(storages) == 1 and not any(entry.is_dir() for entry in entries) and not any(
        entry.suffix == '.bag' for entry in entries)
