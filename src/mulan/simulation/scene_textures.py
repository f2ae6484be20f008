"""Procedural bitmaps for the built-in scene, all 8-bit sRGB, all from a seeded generator."""

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Colour = tuple[float, float, float]
"""sRGB in 0..1."""


def to_bytes(image: Float[NDArray, "h w 3"]) -> UInt8[NDArray, "h w 3"]:
    """8-bit copy of an image in 0..1."""
    return np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)


def noise(height: int, width: int, cell: float, rng: np.random.Generator) -> Float[NDArray, "h w"]:
    """Smooth tileable noise, mean 0.5, most values in 0..1, features about ``cell`` pixels wide."""
    field = gaussian_filter(rng.normal(size=(height, width)), cell, mode="wrap")
    return 0.5 + 0.2 * field / max(float(field.std()), 1e-12)


def _grain(height: int, width: int, rng: np.random.Generator) -> Float[NDArray, "h w"]:
    """Wood grain along the width."""
    warp = gaussian_filter(rng.normal(size=(height, width)), (6, 60), mode="wrap")
    rows = np.arange(height)[:, None] / height
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * rows + 1.5 * warp / warp.std()))
    fibre = gaussian_filter(rng.normal(size=(height, width)), (0.7, 14), mode="wrap")
    return 0.6 * rings + 0.4 * (0.5 + 0.25 * fibre / fibre.std())


def planks(
    rows: int, columns: int, size: int, dark: Colour, light: Colour, rng: np.random.Generator
) -> UInt8[NDArray, "h w 3"]:
    """Staggered boards with grain, one tone each, thin dark joints; ``size`` pixels square."""
    board_h, board_w = size // rows, size // columns
    image = np.zeros((board_h * rows, board_w * columns, 3))
    low, high = np.array(dark), np.array(light)
    for row in range(rows):
        for column in range(columns):
            grain = _grain(board_h, board_w, rng)
            board = low + (high - low) * (0.75 * grain + 0.25)[..., None]
            board *= rng.uniform(0.68, 1.15)
            board[:2] *= 0.3
            board[:, :2] *= 0.3
            image[row * board_h : (row + 1) * board_h, column * board_w : (column + 1) * board_w] = board
        shift = (row * 2 % 5) * board_w // 5
        band = slice(row * board_h, (row + 1) * board_h)
        image[band] = np.roll(image[band], shift, axis=1)
    return to_bytes(image)


def bricks(rows: int, columns: int, size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """A running-bond brick wall with pale mortar."""
    h, w = size // rows, size // columns
    image = np.zeros((h * rows, w * columns, 3))
    rough = noise(h * rows, w * columns, 2.0, rng)
    blotch = noise(h * rows, w * columns, 12.0, rng)
    palette = np.array([[0.66, 0.30, 0.22], [0.74, 0.40, 0.28], [0.55, 0.25, 0.20], [0.80, 0.52, 0.38]])
    for row in range(rows):
        band = np.zeros((h, w * columns, 3))
        for column in range(columns):
            tone = palette[rng.integers(4)] * rng.uniform(0.8, 1.15)
            band[:, column * w : (column + 1) * w] = tone
            band[:, column * w : column * w + 4] = 0.78
        band[:4] = 0.78
        image[row * h : (row + 1) * h] = np.roll(band, (row % 2) * w // 2, axis=1)
    return to_bytes(image * (0.72 + 0.3 * rough + 0.26 * blotch)[..., None])


def plaster(size: int, tone: Colour, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """Trowelled plaster: blotches over three scales."""
    relief = np.sum([noise(size, size, cell, rng) for cell in (1.5, 6.0, 24.0)], axis=0)
    return to_bytes(np.array(tone) * (0.62 + 0.25 * relief)[..., None])


def damask(
    repeat: int, size: int, ground: Colour, figure: Colour, rng: np.random.Generator
) -> UInt8[NDArray, "h w 3"]:
    """Wallpaper of interlocking rosettes."""
    v, u = np.mgrid[0:size, 0:size] / size * repeat
    u = u + 0.5 * (np.floor(v) % 2)
    x, y = 2 * (u % 1) - 1, 2 * (v % 1) - 1
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    petals = np.cos(6 * angle) * 0.16 + 0.55
    mask = ((np.abs(radius - petals) < 0.13) | (radius < 0.2) | (np.abs(radius - 0.95) < 0.05)).astype(float)
    mask = gaussian_filter(mask, 0.8)[..., None]
    wear = 0.8 + 0.35 * noise(size, size, 10.0, rng)
    return to_bytes((np.array(ground) * (1 - mask) + np.array(figure) * mask) * wear[..., None])


def kilim(size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """A woven rug: stepped diamonds in bands, a border, threads."""
    v, u = np.mgrid[0:size, 0:size] / size
    palette = np.array(
        [[0.62, 0.12, 0.13], [0.93, 0.83, 0.64], [0.09, 0.20, 0.38], [0.86, 0.52, 0.14], [0.12, 0.42, 0.40]]
    )
    diamonds = np.floor(14 * (np.abs((5 * u) % 1 - 0.5) + np.abs((5 * v) % 1 - 0.5))).astype(int)
    index = (diamonds + np.floor(5 * v).astype(int) + 2 * np.floor(5 * u).astype(int)) % 5
    edge = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    zigzag = (np.floor(40 * (u + v)) + np.floor(40 * (u - v))).astype(int) % 2
    index = np.where(edge < 0.09, np.where(zigzag == 0, 1, 0), index)
    index = np.where((edge < 0.02) | (np.abs(edge - 0.09) < 0.008), 2, index)
    thread = 0.88 + 0.12 * np.cos(2 * np.pi * 128 * v) * np.cos(2 * np.pi * 128 * u)
    wear = 0.82 + 0.32 * noise(size, size, 8.0, rng)
    return to_bytes(palette[index] * (thread * wear)[..., None])


def books(shelves: int, size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """Spines of many books on dark shelves."""
    image = np.full((size, size, 3), 0.10)
    shelf_h = size // shelves
    for shelf in range(shelves):
        x = 3
        while x < size - 12:
            width = int(rng.integers(size // 45, size // 18))
            height = int(shelf_h * rng.uniform(0.62, 0.88))
            floor = (shelf + 1) * shelf_h - shelf_h // 14
            tone = np.array(_hue(rng.random(), rng.uniform(0.35, 0.8), rng.uniform(0.4, 0.95)))
            shade = 0.6 + 0.4 * np.sin(np.linspace(0.35, 2.8, max(width - 2, 1)))
            spine = image[floor - height : floor, x : x + width - 2]
            spine[:] = tone * shade[None, : spine.shape[1], None]
            for stripe in (0.12, 0.2, 0.78):
                at = int(stripe * height)
                spine[at : at + max(height // 30, 2)] = np.clip(1.25 - tone, 0, 1)
            x += width
        image[(shelf + 1) * shelf_h - shelf_h // 14 : (shelf + 1) * shelf_h] = (0.42, 0.27, 0.15)
    return to_bytes(image)


def _hue(hue: float, saturation: float, value: float) -> Colour:
    """HSV to RGB."""
    ramp = np.clip(np.abs((hue * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1, 0, 1)
    red, green, blue = value * (1 - saturation + saturation * ramp)
    return float(red), float(green), float(blue)


def leaves(size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """Foliage: overlapping blotches of greens."""
    fine, coarse = noise(size, size, 2.5, rng), noise(size, size, 9.0, rng)
    tone = np.clip(0.7 * fine + 0.5 * coarse - 0.1, 0, 1)[..., None]
    return to_bytes(np.array([0.05, 0.16, 0.04]) * (1 - tone) + np.array([0.55, 0.80, 0.22]) * tone)


def globe(size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """Continents, shores and a graticule in latitude and longitude."""
    height = size // 2
    land = noise(height, size, 22.0, rng) + 0.25 * (noise(height, size, 6.0, rng) - 0.5)
    sea = np.array([0.10, 0.30, 0.58]) * (0.75 + 0.5 * noise(height, size, 15.0, rng))[..., None]
    soil = np.array([0.78, 0.68, 0.36]) * (0.55 + 0.7 * noise(height, size, 5.0, rng))[..., None]
    image = np.where((land > 0.54)[..., None], soil, sea)
    image[np.abs(land - 0.54) < 0.008] = (0.95, 0.93, 0.82)
    v, u = np.mgrid[0:height, 0:size]
    lines = (u % (size // 16) < 2) | (v % (height // 8) < 2)
    image[lines] = 0.6 * image[lines] + 0.4 * 0.95
    return to_bytes(image)


def solar_cells(rows: int, columns: int, size: int, rng: np.random.Generator) -> UInt8[NDArray, "h w 3"]:
    """Blue photovoltaic cells with silver bus bars, each cell a shade of its own."""
    h, w = size // rows, size // columns
    tone = rng.uniform(0.75, 1.25, size=(rows, columns)).repeat(h, 0).repeat(w, 1)
    v, u = np.mgrid[0 : h * rows, 0 : w * columns]
    image = np.array([0.07, 0.15, 0.42]) * tone[..., None]
    fingers = (v % max(h // 6, 3)) < 1
    image[fingers] = 0.5 * image[fingers] + 0.5 * np.array([0.45, 0.55, 0.8])
    image[(u % w < 4) | (v % h < 4)] = (0.88, 0.89, 0.92)
    return to_bytes(image)


def stripes(count: int, size: int, first: Colour, second: Colour) -> UInt8[NDArray, "h w 3"]:
    """Even bands across the width."""
    band = (np.arange(size) * 2 * count // size) % 2
    row = np.where(band[:, None] == 0, np.array(first), np.array(second))
    return to_bytes(np.broadcast_to(row, (size, size, 3)))


def chevrons(count: int, size: int, first: Colour, second: Colour) -> UInt8[NDArray, "h w 3"]:
    """Herringbone bands, as on a tyre."""
    v, u = np.mgrid[0:size, 0:size] / size
    band = np.floor(2 * count * (u + 0.08 * np.abs(2 * v - 1))).astype(int) % 2
    return to_bytes(np.where(band[..., None] == 0, np.array(first), np.array(second)))
