# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The examples in the docstrings of the node and the programs give the stated results."""

import pytest
from examples import failures_in, modules_with_examples

from plane_detector.tools.replay.options import ReplayOptions


@pytest.mark.parametrize('name', modules_with_examples(needs_ros=True))
def test_examples_give_the_stated_results(name):
    assert failures_in(name) == 0


def test_the_options_of_a_replay_have_an_example():
    assert '>>> ' in ReplayOptions.__doc__
