# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What keeps the process running: compiled kernels, signals, threads, memory, missing packages.

Nothing here knows of planes. Go here if kernels are not compiled or not found in the cache
(`compilation`), if a program does not end as it should (`ending`, `stopping`), if a library takes
more threads or memory than it may (`process`), or if a package is missing (`dependencies`).
`plain_text` removes what a terminal would execute from the text of others.
"""
