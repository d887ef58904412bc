# SPDX-License-Identifier: MIT
"""What a run leaves behind: ParaView files, tables, pictures. See the modules."""
