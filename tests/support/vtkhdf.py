# SPDX-License-Identifier: MIT
"""ParaView files read back with VTK's own reader."""

import pytest


def read_vtkhdf(path, time=None):
    """Read lines with VTK's own reader: points (n, 3), lines (m, 2), point data, cell data.

    Of a series, at one of its times.
    """
    pytest.importorskip("vtkmodules")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    if time is None:
        reader.Update()
    else:
        reader.UpdateTimeStep(time)
    grid = reader.GetOutput()
    assert grid.IsA("vtkUnstructuredGrid")
    assert {grid.GetCellType(i) for i in range(grid.GetNumberOfCells())} == {3}
    data = [
        {d.GetArrayName(i): vtk_to_numpy(d.GetArray(i)) for i in range(d.GetNumberOfArrays())}
        for d in (grid.GetPointData(), grid.GetCellData())
    ]
    lines = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, 2)
    return vtk_to_numpy(grid.GetPoints().GetData()), lines, *data


def times_of(path):
    """Times that VTK's reader finds in a file."""
    pytest.importorskip("vtkmodules")
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    return reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
