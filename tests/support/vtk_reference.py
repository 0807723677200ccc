"""Renders a raw volume with one of VTK's volume ray casters, for comparison.

Usage: python3 vtk_reference.py request.json

The request is one JSON object:

  raw             file of little-endian f32 samples, x fastest
  dims            [x, y, z], number of samples along each axis
  spacing, origin world distance between samples, world centre of the first one
  eye, target, up, fov_y_degrees, width, height   the perspective camera
  span            [lo, hi], the data values of the fractions 0 and 1 below
  colors          [[fraction, r, g, b], ...] linearly interpolated
  opacity         [[fraction, a], ...] linearly interpolated
  unit_distance   world length over which `opacity` accrues
  step            world distance between samples along a ray
  shade, ambient, diffuse, specular, power
                  one white headlight; the coefficients are used with `shade`
  mapper          "fixed", "gpu" or "smart"
  repeats         number of timed renderings after the first (default 1)
  threads         number of threads, 0 for VTK's default
  out             file for the pixels
  png             optional file for the picture over white

`out` gets width * height * 4 little-endian f32, top row first: red, green, blue
and alpha with the colour PREMULTIPLIED by alpha, over nothing. Over a background
b the picture is rgb + (1 - alpha) * b. With "fixed" they are the mapper's own
image, in 15 bits a channel: the picture in the window is that image stretched by
up to half a pixel. With "gpu" and "smart" they are the window's 8-bit pixels.

Standard output gets one JSON object: the seconds of every timed rendering and
those of all its threads together, the first one's apart (it prepares tables,
gradients and textures, and compiles shaders), what rendered
(VTK, mapper, OpenGL), the range of the data, the clipping range of the camera
(the fixed-point mapper counts its samples from the near plane) and the largest
alpha.

Needs the packages `vtk` (tried: 9.7.2) and `numpy`, and no display. VTK draws
through EGL or OSMesa where there is no X server; on Debian either of these
suffices, the rendering being in software:

  apt-get install libegl1 libgl1-mesa-dri
  apt-get install libosmesa6

VTK_DEFAULT_OPENGL_WINDOW=vtkEGLRenderWindow or =vtkOSOpenGLRenderWindow chooses
between the two.
"""

import ctypes
import json
import math
import os
import re
import sys
import time

REQUIRED = (
    "raw dims spacing origin eye target up fov_y_degrees width height span colors "
    "opacity unit_distance step mapper out"
).split()
MAPPERS = ("fixed", "gpu", "smart")


class RequestError(Exception):
    """What is wrong with the request, in words for its author."""


def numbers(request, key, count):
    value = request[key]
    if (
        not isinstance(value, list)
        or len(value) != count
        or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in value)
    ):
        raise RequestError(f"`{key}` must be {count} finite numbers, not {value!r}")
    return [float(v) for v in value]


def number(request, key, default=None, above=None):
    value = request.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise RequestError(f"`{key}` must be a finite number, not {value!r}")
    if above is not None and value <= above:
        raise RequestError(f"`{key}` must be above {above}, not {value!r}")
    return float(value)


def whole(request, key, least, default=None):
    value = request.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise RequestError(f"`{key}` must be a whole number of at least {least}, not {value!r}")
    return value


def control_points(request, key, count):
    points = request[key]
    if not isinstance(points, list) or not points:
        raise RequestError(f"`{key}` must be a list of at least one point")
    points = [numbers({key: point}, key, count) for point in points]
    fractions = [point[0] for point in points]
    if fractions != sorted(fractions):
        raise RequestError(f"the fractions of `{key}` must not decrease")
    return points


def read_request(path):
    try:
        with open(path, encoding="utf-8") as file:
            request = json.load(file)
    except (OSError, ValueError) as error:
        raise RequestError(f"cannot read the request {path}: {error}") from error
    if not isinstance(request, dict):
        raise RequestError(f"the request {path} is not a JSON object")
    missing = [key for key in REQUIRED if key not in request]
    if missing:
        raise RequestError(f"the request {path} lacks {', '.join(missing)}")
    if request["mapper"] not in MAPPERS:
        raise RequestError(f"`mapper` must be one of {MAPPERS}, not {request['mapper']!r}")
    return request


def make_image(vtk, numpy, request):
    """The volume, and the array that it borrows its samples from."""
    dims = numbers(request, "dims", 3)
    if any(d < 2 or d != int(d) for d in dims):
        raise RequestError(f"`dims` must be whole numbers of at least 2, not {dims}")
    dims = [int(d) for d in dims]
    spacing = numbers(request, "spacing", 3)
    if min(spacing) <= 0:
        raise RequestError(f"`spacing` must be above 0, not {spacing}")
    try:
        samples = numpy.fromfile(request["raw"], dtype="<f4")
    except OSError as error:
        raise RequestError(f"cannot read the volume: {error}") from error
    if samples.size != math.prod(dims):
        raise RequestError(
            f"{request['raw']} holds {samples.size} samples, but {dims} needs {math.prod(dims)}"
        )
    if not numpy.isfinite(samples).all():
        raise RequestError(f"{request['raw']} holds samples that are not finite")

    from vtkmodules.util.numpy_support import numpy_to_vtk

    image = vtk.vtkImageData()
    image.SetDimensions(dims)
    image.SetSpacing(spacing)
    image.SetOrigin(numbers(request, "origin", 3))
    image.GetPointData().SetScalars(numpy_to_vtk(samples, deep=False))
    return image, samples


def make_property(vtk, request):
    lo, hi = numbers(request, "span", 2)
    if not lo < hi:
        raise RequestError(f"`span` must be increasing, not {[lo, hi]}")

    colors = vtk.vtkColorTransferFunction()
    colors.SetColorSpaceToRGB()
    colors.SetAllowDuplicateScalars(True)
    for fraction, red, green, blue in control_points(request, "colors", 4):
        colors.AddRGBPoint(lo + fraction * (hi - lo), red, green, blue)

    opacity = vtk.vtkPiecewiseFunction()
    opacity.SetAllowDuplicateScalars(True)
    for fraction, alpha in control_points(request, "opacity", 2):
        opacity.AddPoint(lo + fraction * (hi - lo), alpha)

    result = vtk.vtkVolumeProperty()
    result.SetColor(colors)
    result.SetScalarOpacity(opacity)
    result.SetScalarOpacityUnitDistance(number(request, "unit_distance", above=0))
    result.SetInterpolationTypeToLinear()
    result.SetDisableGradientOpacity(True)
    result.SetShade(bool(request.get("shade", False)))
    result.SetAmbient(number(request, "ambient", 0.1))
    result.SetDiffuse(number(request, "diffuse", 0.7))
    result.SetSpecular(number(request, "specular", 0.2))
    result.SetSpecularPower(number(request, "power", 10.0))
    return result


def make_mapper(vtk, request, threads):
    """A mapper that samples at `step` exactly: no jitter, no coarser image."""
    step = number(request, "step", above=0)
    kind = request["mapper"]
    if kind == "fixed":
        mapper = vtk.vtkFixedPointVolumeRayCastMapper()
        mapper.SetInteractiveSampleDistance(step)
        mapper.SetImageSampleDistance(1.0)
        mapper.SetLockSampleDistanceToInputSpacing(False)
        mapper.IntermixIntersectingGeometryOff()
        if threads:
            mapper.SetNumberOfThreads(threads)
    elif kind == "gpu":
        mapper = vtk.vtkGPUVolumeRayCastMapper()
        mapper.SetImageSampleDistance(1.0)
        mapper.SetLockSampleDistanceToInputSpacing(False)
        mapper.SetUseJittering(False)
    else:
        mapper = vtk.vtkSmartVolumeMapper()
        mapper.SetRequestedRenderModeToDefault()
        mapper.SetInteractiveAdjustSampleDistances(False)
        mapper.SetUseJittering(False)
    mapper.SetAutoAdjustSampleDistances(False)
    mapper.SetSampleDistance(step)
    mapper.SetBlendModeToComposite()
    return mapper


def mapper_image(numpy, image, width, height):
    """What the fixed-point mapper cast, bottom row first, before it is drawn as a texture."""
    viewport = image.GetImageViewportSize()
    memory, used = image.GetImageMemorySize(), image.GetImageInUseSize()
    origin = image.GetImageOrigin()
    if tuple(viewport) == (0, 0):
        raise RequestError("the mapper cast no rays; is the volume in view?")
    if tuple(viewport) != (width, height):
        raise RequestError(f"the mapper cast {viewport} rays, not {(width, height)}")
    # The address of 16-bit values, as VTK's wrapping writes a pointer.
    address = re.fullmatch(r"_([0-9a-fA-F]+)_p_\w+", str(image.GetImage()))
    if not address:
        raise RequestError(f"cannot read the mapper's image at {image.GetImage()!r}")
    values = ctypes.c_uint16 * (memory[0] * memory[1] * 4)
    stored = numpy.frombuffer(values.from_address(int(address[1], 16)), dtype=numpy.uint16)
    stored = stored.reshape(memory[1], memory[0], 4)[: used[1], : used[0]]
    pixels = numpy.zeros((height, width, 4))
    pixels[origin[1] : origin[1] + used[1], origin[0] : origin[0] + used[0]] = stored / 32767
    return pixels


def used_mapper(mapper):
    name = mapper.GetClassName()
    if name == "vtkSmartVolumeMapper":
        modes = {
            mapper.RayCastRenderMode: "vtkFixedPointVolumeRayCastMapper",
            mapper.GPURenderMode: "vtkGPUVolumeRayCastMapper",
        }
        mode = mapper.GetLastUsedRenderMode()
        return f"{name} ({modes.get(mode, f'render mode {mode}')})"
    return name


def opengl(window):
    lines = window.ReportCapabilities().splitlines()
    named = dict(line.split(":", 1) for line in lines if line.startswith("OpenGL ") and ":" in line)
    text = [named.get(f"OpenGL {what} string", "").strip() for what in ("renderer", "version")]
    return ", ".join(t for t in text if t)


def render(request):
    threads = whole(request, "threads", 0, 0)
    if threads:
        # Read by the software OpenGL when it starts.
        os.environ["LP_NUM_THREADS"] = str(threads)
    try:
        import numpy
        import vtk
        from vtkmodules.util.numpy_support import vtk_to_numpy
    except ImportError as error:
        raise RequestError(f"needs the packages `vtk` and `numpy`: {error}") from error
    if threads:
        vtk.vtkMultiThreader.SetGlobalMaximumNumberOfThreads(threads)
        vtk.vtkSMPTools.Initialize(threads)

    width, height = whole(request, "width", 1), whole(request, "height", 1)
    repeats = whole(request, "repeats", 0, 1)
    image, samples = make_image(vtk, numpy, request)
    mapper = make_mapper(vtk, request, threads)
    mapper.SetInputData(image)
    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(make_property(vtk, request))

    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(0)
    window.SetAlphaBitPlanes(True)
    window.SetSize(width, height)
    renderer = vtk.vtkRenderer()
    renderer.SetBackground(0.0, 0.0, 0.0)
    renderer.SetBackgroundAlpha(0.0)
    renderer.SetAutomaticLightCreation(False)
    light = vtk.vtkLight()
    light.SetLightTypeToHeadlight()
    light.SetColor(1.0, 1.0, 1.0)
    light.SetAmbientColor(1.0, 1.0, 1.0)
    light.SetIntensity(1.0)
    renderer.AddLight(light)
    renderer.AddVolume(volume)
    window.AddRenderer(renderer)

    eye = numbers(request, "eye", 3)
    target = numbers(request, "target", 3)
    if eye == target:
        raise RequestError("`eye` and `target` must differ")
    up = numbers(request, "up", 3)
    if numpy.linalg.norm(numpy.cross(numpy.subtract(target, eye), up)) < 1e-9:
        raise RequestError("`up` must not be along the view")
    camera = renderer.GetActiveCamera()
    camera.SetFocalPoint(target)
    camera.SetViewUp(up)
    camera.SetViewAngle(number(request, "fov_y_degrees", above=0))

    def timed_render(nudge):
        # A camera that moves imperceptibly keeps anything from being reused.
        camera.SetPosition([e + nudge * (e - t) for e, t in zip(eye, target)])
        renderer.ResetCameraClippingRange()
        start, spent = time.perf_counter(), time.process_time()
        window.Render()
        window.WaitForCompletion()
        return time.perf_counter() - start, time.process_time() - spent

    first = timed_render(1e-6)
    # The last one is exactly where the request says.
    times = [timed_render(((repeats - i) % 2) * 1e-6) for i in range(1, repeats + 1)]
    if not repeats:
        timed_render(0.0)

    actual = list(window.GetSize())
    if actual != [width, height]:
        raise RequestError(f"the window is {actual}, not {[width, height]}")
    if request["mapper"] == "fixed":
        pixels = mapper_image(numpy, mapper.GetRayCastImage(), width, height)
    else:
        array = vtk.vtkUnsignedCharArray()
        window.GetRGBACharPixelData(0, 0, width - 1, height - 1, 0, array)
        pixels = vtk_to_numpy(array).reshape(height, width, 4) / 255
    pixels = numpy.ascontiguousarray(pixels[::-1], dtype="<f4")
    pixels.tofile(request["out"])
    if request.get("png"):
        over_white = pixels[..., :3] + (1 - pixels[..., 3:])
        write_png(vtk, request["png"], numpy.clip(over_white * 255 + 0.5, 0, 255).astype("u1"))

    return {
        "first_seconds": first[0],
        "seconds": [wall for wall, _ in times],
        "cpu_seconds": [cpu for _, cpu in times],
        "vtk": vtk.vtkVersion.GetVTKVersion(),
        "mapper": used_mapper(mapper),
        "window": window.GetClassName(),
        "opengl": opengl(window),
        "threads": mapper.GetNumberOfThreads() if request["mapper"] == "fixed" else threads,
        "data_range": [float(samples.min()), float(samples.max())],
        "clipping_range": list(camera.GetClippingRange()),
        "max_alpha": float(pixels[..., 3].max()),
    }


def write_png(vtk, path, pixels):
    from vtkmodules.util.numpy_support import numpy_to_vtk

    height, width, channels = pixels.shape
    image = vtk.vtkImageData()
    image.SetDimensions(width, height, 1)
    bottom_up = pixels[::-1].reshape(-1, channels)
    image.GetPointData().SetScalars(numpy_to_vtk(bottom_up, deep=True))
    writer = vtk.vtkPNGWriter()
    writer.SetFileName(path)
    writer.SetInputData(image)
    writer.Write()


def main(arguments):
    if len(arguments) != 2:
        sys.exit(f"usage: {arguments[0]} request.json")
    try:
        print(json.dumps(render(read_request(arguments[1]))))
    except RequestError as error:
        sys.exit(f"{arguments[0]}: {error}")


if __name__ == "__main__":
    main(sys.argv)
