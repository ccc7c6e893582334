# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Runtime support of the process: compiled kernels, signals, threads, memory, missing packages.

Nothing here knows about planes. Look here if kernels are not compiled or not found in the cache
(`compilation`), if a program does not end as it should (`ending`, `stopping`), if a library takes
more threads or memory than it should (`process`), or if a package is missing (`dependencies`).
`plain_text` removes terminal control sequences from external text.
"""
