# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A DDS domain for programs that must be isolated from other ROS nodes."""

import os
import random
import socket

# chosen: below the ephemeral ports, from 32768 on; one port per domain.
_FIRST_PORT = 22119
_LARGEST_DOMAIN = 101  # ports of a larger one may clash with those
_held: list[socket.socket] = []


def private_domain() -> int:
    """
    Return a domain that no other process on this machine gets from here while this one runs.

    Every call returns a new one. From then on, this process and its children find only nodes on
    this machine. A domain is reserved by a bound port on which nothing listens, as in ROS 2's
    domain_coordinator, so it is released with the process, however that ends.

    Raises
    ------
    RuntimeError
        All domains are taken.

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
