# SPDX-License-Identifier: MIT
"""Forming: a blank of cloth pressed over tools, stage by stage."""
