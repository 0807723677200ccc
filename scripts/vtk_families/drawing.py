"""Pictures of a scene's steps by VTK: whole, of one cell alone, and the share of each cell in each pixel.

Pictures are `[height, width, 4]`, colours times alpha, from 0 to 1, the first row on top.
"""

import numpy as np
import vtk
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from .scene import Transfer

BASIS = np.eye(3)
BLACK = (0.0, 0.0, 0.0)


def image_of(array, side):
    """An array `[z, y, x]` as image data that fills the cube of this side around the origin."""
    count = array.shape[0]
    image = vtk.vtkImageData()
    image.SetDimensions(count, count, count)
    image.SetSpacing(*[side / (count - 1)] * 3)
    image.SetOrigin(*[-side / 2] * 3)
    image.GetPointData().SetScalars(numpy_to_vtk(array.ravel(), deep=True))
    return image


def colours_of(points):
    colours = vtk.vtkColorTransferFunction()
    colours.SetColorSpaceToRGB()
    for value, red, green, blue in points:
        colours.AddRGBPoint(value, red, green, blue)
    return colours


def opacities_of(points):
    opacities = vtk.vtkPiecewiseFunction()
    for value, opacity in points:
        opacities.AddPoint(value, opacity)
    return opacities


def opacity_at(transfer: Transfer, values):
    return np.interp(values, *np.array(transfer.opacity, float).T)


class Drawer:
    """A window without a screen. `finer` draws that many pixels for one, along each side."""

    def __init__(self, scene, size, fov_degrees, finer=1):
        self.scene, self.size, self.finer = scene, size, finer
        self.window, self.renderer = vtk.vtkRenderWindow(), vtk.vtkRenderer()
        self.window.SetOffScreenRendering(True)
        self.window.SetMultiSamples(0)
        self.window.SetAlphaBitPlanes(True)
        self.window.SetSize(size * finer, size * finer)
        self.renderer.SetBackground(*BLACK)
        self.renderer.SetBackgroundAlpha(0)
        self.renderer.SetAutomaticLightCreation(False)
        for light in lights(scene.light):
            self.renderer.AddLight(light)
        self.window.AddRenderer(self.renderer)
        self.camera = self.renderer.GetActiveCamera()
        self.camera.SetViewAngle(fov_degrees)

    def aim(self, pose):
        """Takes the place of a camera, given by its camera-to-world matrix."""
        eye = pose[:3, 3]
        self.camera.SetPosition(*eye)
        self.camera.SetFocalPoint(*(eye - pose[:3, 2] * np.linalg.norm(eye)))
        self.camera.SetViewUp(*pose[:3, 1])
        self.renderer.ResetCameraClippingRange()

    def pixels(self):
        self.window.Render()
        self.window.WaitForCompletion()
        n = self.size * self.finer
        data = vtk.vtkUnsignedCharArray()
        self.window.GetRGBACharPixelData(0, 0, n - 1, n - 1, 0, data)
        fine = vtk_to_numpy(data).reshape(n, n, 4)[::-1].astype(np.float32) / 255
        return fine.reshape(self.size, self.finer, self.size, self.finer, 4).mean(axis=(1, 3))

    def graphics(self):
        """What draws, for the record."""
        lines = self.window.ReportCapabilities().splitlines()
        named = dict(line.split(":", 1) for line in lines if line.startswith("OpenGL ") and ":" in line)
        return ", ".join(named.get(f"OpenGL {what} string", "unknown").strip() for what in ("renderer", "version"))

    def shares(self, ids):
        """The share of each cell of `ids` in the light of each pixel, `[cell, height, width]`: three at once, drawn
        unlit in red, green and blue while all others are black."""
        found = []
        for first in range(0, len(ids), 3):
            three = ids[first : first + 3]
            self.paint(three)
            found += list(np.moveaxis(self.pixels(), -1, 0)[: len(three)])
        self.unpaint()
        return np.stack(found) if found else np.zeros((0, self.size, self.size))


def lights(light):
    head = vtk.vtkLight()
    head.SetLightTypeToHeadlight()
    head.SetIntensity(light.head)
    head.SetAmbientColor(1, 1, 1)
    found = [head]
    if light.key > 0:
        key = vtk.vtkLight()
        key.SetLightTypeToSceneLight()
        key.SetPositional(False)
        key.SetPosition(*(10 * c for c in light.direction))
        key.SetFocalPoint(0, 0, 0)
        key.SetIntensity(light.key)
        found.append(key)
    return found


class VolumeDrawer(Drawer):
    """Draws volumes by VTK's GPU ray caster, which needs no GPU: software OpenGL suffices."""

    def __init__(self, scene, size, fov_degrees, side, count):
        super().__init__(scene, size, fov_degrees)
        self.side = side
        transfer, material = scene.transfer, scene.material
        self.unit, self.step = transfer.unit * side, 0.5 * side / (count - 1)
        self.mapper = vtk.vtkGPUVolumeRayCastMapper()
        self.mapper.SetAutoAdjustSampleDistances(False)
        self.mapper.SetLockSampleDistanceToInputSpacing(False)
        self.mapper.SetImageSampleDistance(1)
        self.mapper.SetSampleDistance(self.step)
        self.mapper.SetUseJittering(False)
        self.mapper.SetBlendModeToComposite()
        self.colours = colours_of(transfer.colors)
        self.property = vtk.vtkVolumeProperty()
        self.property.SetColor(self.colours)
        self.property.SetScalarOpacity(opacities_of(transfer.opacity))
        self.property.SetScalarOpacityUnitDistance(self.unit)
        self.property.SetInterpolationTypeToLinear()
        self.property.SetDisableGradientOpacity(True)
        self.property.SetShade(True)
        self.property.SetAmbient(material.ambient)
        self.property.SetDiffuse(material.diffuse)
        self.property.SetSpecular(material.specular)
        self.property.SetSpecularPower(material.power)
        volume = vtk.vtkVolume()
        volume.SetMapper(self.mapper)
        volume.SetProperty(self.property)
        self.renderer.AddVolume(volume)
        # VTK applies the opacity of a label to each sample as it is, whatever the distance to the next one
        at = np.linspace(0, 1, 1025)
        per_sample = 1 - (1 - opacity_at(transfer, at)) ** (self.step / self.unit)
        self.per_sample = opacities_of(zip(at, per_sample))

    def show(self, volume):
        self.ids = volume.ids
        self.mapper.SetMaskInput(None)
        self.mapper.SetInputData(image_of(volume.values, self.side))
        self.labels = image_of(volume.ids, self.side)
        self.picked = None

    def picture(self):
        return self.pixels()

    def pick(self, segment):
        """Shows the samples whose nearest voxel belongs to the cell, lit as in the whole picture."""
        mask = np.where(self.ids == segment, 255, 0).astype(np.uint8)
        self.mapper.SetMaskInput(image_of(mask, self.side))
        self.mapper.SetMaskTypeToBinary()

    def unpick(self):
        self.mapper.SetMaskInput(None)

    def paint(self, three):
        self.property.SetShade(False)
        self.property.SetColor(colours_of([(0, *BLACK)]))
        for segment in range(1, len(self.scene.names) + 1):
            colour = BASIS[three.index(segment)] if segment in three else BLACK
            self.property.SetLabelColor(segment, colours_of([(0, *colour), (1, *colour)]))
            self.property.SetLabelScalarOpacity(segment, self.per_sample)
        self.mapper.SetMaskInput(self.labels)
        self.mapper.SetMaskTypeToLabelMap()
        self.mapper.SetMaskBlendFactor(1)

    def unpaint(self):
        self.property.SetShade(True)
        self.property.SetColor(self.colours)
        self.mapper.SetMaskInput(None)


class SurfaceDrawer(Drawer):
    """Draws contour surfaces with Phong's shading; translucent ones in the right order, by depth peeling."""

    def __init__(self, scene, size, fov_degrees, side):
        super().__init__(scene, size, fov_degrees, finer=2)
        self.side, self.actors = side, {}
        self.renderer.SetUseDepthPeeling(True)
        self.renderer.SetMaximumNumberOfPeels(16)
        self.renderer.SetOcclusionRatio(0)
        for segment, look in scene.surfaces.items():
            actor = vtk.vtkActor()
            shine = actor.GetProperty()
            shine.SetInterpolationToPhong()
            shine.SetColor(*look.color)
            shine.SetOpacity(look.opacity)
            shine.SetAmbient(scene.material.ambient)
            shine.SetDiffuse(scene.material.diffuse)
            shine.SetSpecular(scene.material.specular)
            shine.SetSpecularPower(scene.material.power)
            self.renderer.AddActor(actor)
            self.actors[segment] = actor

    def show(self, fields):
        for segment, values in fields.items():
            contour = vtk.vtkFlyingEdges3D()
            contour.SetInputData(image_of(values, self.side))
            contour.SetValue(0, 0.0)
            contour.ComputeNormalsOn()
            contour.ComputeScalarsOff()
            mapper = vtk.vtkPolyDataMapper()
            mapper.SetInputConnection(contour.GetOutputPort())
            self.actors[segment].SetMapper(mapper)

    def picture(self):
        return self.pixels()

    def pick(self, segment):
        for other, actor in self.actors.items():
            actor.SetVisibility(other == segment)

    def unpick(self):
        for actor in self.actors.values():
            actor.SetVisibility(True)

    def paint(self, three):
        for segment, actor in self.actors.items():
            actor.GetProperty().SetLighting(False)
            actor.GetProperty().SetColor(*(BASIS[three.index(segment)] if segment in three else BLACK))

    def unpaint(self):
        for segment, actor in self.actors.items():
            actor.GetProperty().SetLighting(True)
            actor.GetProperty().SetColor(*self.scene.surfaces[segment].color)


def drawer_of(scene, size, fov_degrees, side, count):
    if scene.surfaces:
        return SurfaceDrawer(scene, size, fov_degrees, side)
    return VolumeDrawer(scene, size, fov_degrees, side, count)
