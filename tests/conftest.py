# SPDX-License-Identifier: MIT
"""Puts this folder on the path, so that tests here and in subfolders can import helpers."""
