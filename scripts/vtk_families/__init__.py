"""Families of scenes with known segments that VTK draws; `scripts/vtk_scenes.py` is the command.

scene     what a family draws from a seed: bodies, looks, lights
shapes    fields of bodies on a grid, and motion: approach, merging, division
volumes   the families that VTK's volume ray caster draws
surfaces  the family of contour surfaces
drawing   VTK: pictures, cells alone, shares of cells in pixels
truth     ids and opacities of a step in space
files     PNG and tensor files
dataset   cameras, and the folder with its ground truth
"""
