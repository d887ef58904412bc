# SPDX-License-Identifier: MIT
"""Element kernels: arrays in, arrays out. They know nothing of ranks, PETSc or files.

All kernels work on n cruciforms at once. Displacements are Cartesian components in one frame,
which the network takes to be the yarn frame (along warp, along weft). Layouts of unknowns:

- displacements only, 10: u_1 (2), u_2 (2), u_3 (2), u_4 (2), hinge u_0 (2);
- with yarn rotations, 16: for each arm end (u, u, psi), then hinge u_0 (2), psi of the warp yarn
  and psi of the weft yarn at the hinge. psi is a rotation times a length, so that all have one
  unit.
"""
