# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A domain of DDS for programs that must neither hear nor disturb other ROS nodes."""

import os
import random
import socket

# chosen: below the ports that systems give away, 32768 on; one number has one port.
_FIRST_PORT = 22119
_LARGEST_DOMAIN = 101  # of a larger one ports may clash with those
_held: list[socket.socket] = []


def private_domain() -> int:
    """
    Return a domain that no other process on this machine has from here until this one ends.

    Every call returns another one. From then on this process and its children find nodes on this
    machine alone. A domain is held by a bound port to which nothing listens, the method of ROS 2's
    domain_coordinator: it ends with the process, however that ends.

    Raises
    ------
    RuntimeError
        All are taken.

    """
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    domains = list(range(1, _LARGEST_DOMAIN + 1))
    random.shuffle(domains)
    for domain in domains:
        held = socket.socket()
        try:
            held.bind(('127.0.0.1', _FIRST_PORT + domain))
        except OSError:
            held.close()
        else:
            _held.append(held)
            return domain
    raise RuntimeError(f'the {_LARGEST_DOMAIN} domains of DDS are all taken by other tests, demos '
                       'or benchmarks on this machine: end some')
