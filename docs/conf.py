# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
README, changelog and the pages of docs/ as one site, built by Sphinx with MyST.

    pip install sphinx myst-parser
    sphinx-build -W -c docs . site

The reference of the Python modules is built by rosdoc2, see config/rosdoc2.yaml.
"""

project = 'plane_detector'
extensions = ['myst_parser']
root_doc = 'README'
include_patterns = ['README.md', 'CHANGELOG.rst', 'docs/*.md', 'LICENSE']
myst_heading_anchors = 4
html_title = project
# Links to code and configuration lead to files of the repository; the README links all pages.
suppress_warnings = ['myst.xref_missing', 'toc.not_included']
