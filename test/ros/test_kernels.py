# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""All kernels, with those of the messages."""

import sys

import plane_detector.pipeline
import plane_detector.ros.outputs.topics  # noqa: F401 - these bring the kernels
from plane_detector._runtime import compilation


def test_every_global_name_that_a_kernel_uses_is_part_of_the_digest():
    for one in compilation._KERNELS:
        names = one._function.__globals__
        for name in one._function.__code__.co_names:
            value = names.get(name, 0)
            assert (isinstance(value, (compilation.Kernel, bool, int, float, str, tuple))
                    or hasattr(value, 'tolist')
                    or value in (sys.modules['numpy'], sys.modules['math'])), (
                f'{one.__name__}: {name}')
