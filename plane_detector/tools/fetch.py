# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Download depth networks in advance; without a name, list all networks."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from plane_detector import PAGES
from plane_detector._runtime.dependencies import explained_imports
from plane_detector._runtime.ending import quiet_interrupt

with quiet_interrupt(), explained_imports():
    from plane_detector.config import DepthConfig
    from plane_detector.depth.networks import AUTO_ORDER, NETWORKS, Network, cached_path, resolve

_HEADER = ('network', 'size', 'licence', 'here', 'gives')


def table(networks: Sequence[Network], cache_dir: str) -> str:
    """Return a table of networks, one per line; ``here``: whether the file is in the cache."""
    rows = [_HEADER, *(
        (network.name,
         f'{network.download_bytes / 1e6:.0f} MB' if network.size_bytes else 'not known',
         network.licence,
         'yes' if cached_path(network, cache_dir).is_file() else '', network.summary)
        for network in networks)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return '\n'.join('  '.join(cell.ljust(width) for cell, width in zip(
        row, widths, strict=True)).rstrip() for row in rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Download the named networks; exit code 1 if one is not available."""
    parser = argparse.ArgumentParser(prog='ros2 run plane_detector fetch', description=__doc__,
                                     epilog=f'More: {PAGES}/networks.md')
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help='network, or auto for the one that depth.model auto would use now')
    parser.add_argument('--cache-dir', default='', help='as depth.cache_dir')
    options = parser.parse_args(arguments)
    if wrong := [name for name in options.names if name not in ('auto', *NETWORKS)]:
        parser.error(f'no network is called {wrong[0]!r}; there are auto, {", ".join(NETWORKS)}')
    if not options.names:
        print(table(list(NETWORKS.values()), options.cache_dir))
        print(f'\ndepth.model auto uses the first available one of: {", ".join(AUTO_ORDER)}')
        return
    for name in options.names:
        try:
            network, path, reason, _ = resolve(
                DepthConfig(model=name, cache_dir=options.cache_dir))
        except FileNotFoundError as error:
            sys.exit(str(error))
        if name == 'auto':
            print(reason)
        print(f'{network.name}: {path}\nlicence: {network.licence}')


if __name__ == '__main__':
    main()
