# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the tests of the node share."""

import pytest
from node_helpers import small_room


@pytest.fixture
def room():
    """Return the furnished room that the camera of these tests sees."""
    return small_room()
