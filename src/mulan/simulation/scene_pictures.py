"""Pictures that hang in the built-in scene: a window view, posters, lettered panels."""

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mulan.simulation.scene_textures import Colour, noise, to_bytes


def lettered(
    picture: UInt8[NDArray, "h w 3"], text: str, centre: tuple[float, float], height: float, ink: Colour
) -> UInt8[NDArray, "h w 3"]:
    """A picture with a line of text; centre and letter height are fractions of width and height."""
    canvas = Image.fromarray(picture)
    font = ImageFont.load_default(size=height * canvas.height)
    at = (centre[0] * canvas.width, centre[1] * canvas.height)
    r, g, b = (round(255 * c) for c in ink)
    ImageDraw.Draw(canvas).text(at, text, fill=(r, g, b), font=font, anchor="mm")
    return np.array(canvas)


def landscape(size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """A window view: clouds over ranges of hills that fade with distance."""
    v, u = np.mgrid[0:size, 0:size] / size
    sky = np.array([0.30, 0.56, 0.92]) * (1 - v)[..., None] + np.array([0.86, 0.93, 1.0]) * v[..., None]
    cloud = np.clip(3 * (noise(size, size, 18.0, rng) + 0.4 * noise(size, size, 5.0, rng) - 0.74), 0, 1)[
        ..., None
    ]
    image = sky * (1 - cloud) + cloud
    shades = [(0.55, 0.68, 0.80), (0.34, 0.54, 0.52), (0.20, 0.42, 0.22), (0.10, 0.28, 0.10)]
    for k, shade in enumerate(shades):
        f = 1.5 + k
        ridge = (
            0.52
            + 0.12 * k
            + 0.07 * np.sin(2 * np.pi * f * u[0] + k)
            + 0.03 * np.sin(2 * np.pi * 3 * f * u[0])
        )
        below = v > ridge[None, :]
        trees = 0.8 + 0.4 * noise(size, size, 2.0 + k, rng)
        image = np.where(below[..., None], np.array(shade) * trees[..., None], image)
    return to_bytes(image)


def mandelbrot_poster(size: int) -> UInt8[NDArray, "h w 3"]:
    """The Mandelbrot set, coloured by escape time."""
    y, x = np.mgrid[-1.25 : 1.25 : size * 1j, -2.0 : 0.6 : size * 1j]
    c = x + 1j * y
    z = np.zeros_like(c)
    escape = np.full(c.shape, 60.0)
    for step in range(60):
        z = np.where(np.abs(z) < 4, z * z + c, z)
        escape = np.where((np.abs(z) >= 4) & (escape == 60), step, escape)
    phase = np.sqrt(escape / 60)[..., None] * 9
    image = 0.5 + 0.5 * np.cos(phase + np.array([3.3, 4.4, 5.5]))
    image[escape == 60] = 0.04
    return lettered(to_bytes(image), "z * z + c", (0.2, 0.92), 0.08, (0.05, 0.2, 0.3))


def planet_poster(size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """A retro travel poster: a ringed planet, sun rays, a red desert."""
    v, u = np.mgrid[0:size, 0:size] / size
    angle = np.arctan2(0.72 - v, u - 0.3)
    rays = (np.floor(angle / np.pi * 24) % 2)[..., None]
    image = rays * np.array([0.98, 0.76, 0.42]) + (1 - rays) * np.array([0.95, 0.55, 0.27])
    radius = np.hypot(u - 0.64, v - 0.36)
    bands = 0.5 + 0.5 * np.sin(70 * (v + 0.25 * u))
    planet = np.array([0.25, 0.48, 0.55]) + bands[..., None] * np.array([0.55, 0.38, 0.22])
    image = np.where((radius < 0.2)[..., None], planet, image)
    ring = np.hypot((u - 0.64) + 0.4 * (v - 0.36), 3.4 * ((v - 0.36) - 0.25 * (u - 0.64)))
    image[(np.abs(ring - 0.32) < 0.035) & ((radius > 0.2) | (v > 0.36))] = (0.98, 0.93, 0.80)
    dune = v > 0.72 + 0.05 * np.sin(7 * u)
    image = np.where(
        dune[..., None],
        np.array([0.60, 0.17, 0.12]) * (0.7 + 0.6 * noise(size, size, 4.0, rng))[..., None],
        image,
    )
    return lettered(to_bytes(image), "MARS 2049", (0.5, 0.9), 0.12, (1.0, 0.95, 0.85))


def chart_poster(size: int) -> UInt8[NDArray, "h w 3"]:
    """A test chart: rings, a Siemens star, colour patches, letters."""
    v, u = np.mgrid[0:size, 0:size] / size
    image = np.full((size, size, 3), 0.95)
    star_r, star_a = np.hypot(u - 0.3, v - 0.32), np.arctan2(v - 0.32, u - 0.3)
    image[(star_r < 0.24) & (np.floor(star_a / np.pi * 16) % 2 == 0)] = 0.05
    ring_r = np.hypot(u - 0.76, v - 0.3)
    image[(ring_r < 0.19) & (np.floor(ring_r * 42) % 2 == 0)] = (0.80, 0.10, 0.12)
    patches = [
        (0.8, 0.1, 0.1),
        (0.95, 0.75, 0.1),
        (0.1, 0.6, 0.25),
        (0.1, 0.3, 0.75),
        (0.5, 0.15, 0.55),
        (0.1, 0.1, 0.1),
    ]
    for k, tone in enumerate(patches):
        image[
            int(0.62 * size) : int(0.76 * size), int((0.06 + 0.15 * k) * size) : int((0.19 + 0.15 * k) * size)
        ] = tone
    return lettered(to_bytes(image), "E F P T O Z", (0.5, 0.88), 0.13, (0.05, 0.05, 0.05))


def hull_panel(height: int, label: str, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """A machine's side panel, three times as wide as high: seams, rivets, a hazard stripe and a name."""
    width = 3 * height
    v, u = np.mgrid[0:height, 0:width] / np.array([height, width])[:, None, None]
    image = np.array([0.90, 0.88, 0.84]) * (0.86 + 0.24 * noise(height, width, 9.0, rng))[..., None]
    hazard = np.floor(5 * (3 * u + v)) % 2 == 0
    band = v > 0.8
    image[band] = np.where(hazard[..., None], np.array([0.97, 0.74, 0.08]), np.array([0.08, 0.08, 0.08]))[
        band
    ]
    seams = (np.abs(u - 0.33) < 0.006) | (np.abs(u - 0.67) < 0.006) | (np.abs(v - 0.14) < 0.01)
    image[seams] = 0.25
    rivets = (np.hypot((u * 18) % 1 - 0.5, (v * 6) % 1 - 0.5) < 0.16) & (
        (v < 0.17) | ((v > 0.62) & (v < 0.8))
    )
    image[rivets] = 0.35
    return lettered(to_bytes(image), label, (0.5, 0.4), 0.46, (0.72, 0.12, 0.10))


def crate_panel(planked: UInt8[NDArray, "h w 3"], label: str) -> UInt8[NDArray, "h w 3"]:
    """A crate's side: planks framed by battens, one diagonal, a stencil."""
    size = len(planked)
    v, u = np.mgrid[0:size, 0 : planked.shape[1]] / size
    image = planked / 255.0
    edge = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    batten = (edge < 0.11) | (np.abs(u - v) < 0.07)
    image[batten] = 0.55 * image[batten] + 0.45 * np.array([0.80, 0.60, 0.36])
    image[(np.abs(edge - 0.11) < 0.01) | ((np.abs(np.abs(u - v) - 0.07) < 0.008) & (edge > 0.11))] = 0.12
    return lettered(to_bytes(image), label, (0.62, 0.3), 0.16, (0.10, 0.09, 0.08))
