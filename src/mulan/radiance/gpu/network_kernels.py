"""The small networks (``networks.py`` is their reference), each fused: activations never leave the program.

Parameters lie one matrix after another, ``[outputs, inputs]`` each, in the order of ``NETWORKS``. Tiles of
matrices and activations are padded with zeros to powers of two.
"""

from typing import no_type_check

import triton
import triton.language as tl

from mulan.radiance.networks import LOG_DENSITY_MAX, LOG_DENSITY_OFFSET, VARIANCE_FLOOR

OFFSET, LARGEST, FLOOR = (tl.constexpr(x) for x in (LOG_DENSITY_OFFSET, LOG_DENSITY_MAX, VARIANCE_FLOOR))
HARMONICS = tl.constexpr(16)  # columns kept for the harmonics of a direction, whatever their degree


@triton.jit
@no_type_check
def load_matrix(
    at, ROWS: tl.constexpr, COLUMNS: tl.constexpr, STRIDE: tl.constexpr, RP: tl.constexpr, CP: tl.constexpr
):
    """A matrix as a tile [RP, CP]."""
    r, c = tl.arange(0, RP)[:, None], tl.arange(0, CP)[None, :]
    return tl.load(at + r * STRIDE + c, mask=(r < ROWS) & (c < COLUMNS), other=0.0)


@triton.jit
@no_type_check
def store_matrix(
    at,
    tile,
    ROWS: tl.constexpr,
    COLUMNS: tl.constexpr,
    STRIDE: tl.constexpr,
    RP: tl.constexpr,
    CP: tl.constexpr,
):
    """Inverse of :func:`load_matrix`."""
    r, c = tl.arange(0, RP)[:, None], tl.arange(0, CP)[None, :]
    tl.store(at + r * STRIDE + c, tile, mask=(r < ROWS) & (c < COLUMNS))


@triton.jit
@no_type_check
def multiply(a, b, OPERAND: tl.constexpr, PRODUCT: tl.constexpr):
    """Matrix product with float32 sums."""
    return tl.dot(a.to(OPERAND), b.to(OPERAND), input_precision=PRODUCT)


@triton.jit
@no_type_check
def load_rows(at, index, on, room, COLUMNS: tl.constexpr, CP: tl.constexpr):
    """Rows [B, CP] of an array that is kept column by column."""
    c = tl.arange(0, CP)[None, :]
    return tl.load(at + c * room + index[:, None], mask=on[:, None] & (c < COLUMNS), other=0.0)


@triton.jit
@no_type_check
def store_rows(at, rows, index, on, room, COLUMNS: tl.constexpr, CP: tl.constexpr):
    """Inverse of :func:`load_rows`."""
    c = tl.arange(0, CP)[None, :]
    tl.store(at + c * room + index[:, None], rows, mask=on[:, None] & (c < COLUMNS))


@triton.jit(do_not_specialize=["n"])
@no_type_check
def density_kernel(
    encoded,
    networks,
    density,
    n,
    room,
    E: tl.constexpr,
    W: tl.constexpr,
    EP: tl.constexpr,
    WP: tl.constexpr,
    OPERAND: tl.constexpr,
    PRODUCT: tl.constexpr,
    B: tl.constexpr,
):
    """Density per scene radius; the one output of the second layer that it needs is summed in float32."""
    i = tl.program_id(0) * B + tl.arange(0, B)
    on = i < n
    x = load_rows(encoded, i, on, room, E, EP)
    first = load_matrix(networks, W, E, E, WP, EP)
    hidden = tl.maximum(multiply(x, tl.trans(first), OPERAND, PRODUCT), 0.0)
    unit = tl.arange(0, WP)
    second = tl.load(networks + W * E + unit, mask=unit < W, other=0.0)
    raw = tl.sum(hidden * second[None, :], 1)
    tl.store(density + i, tl.exp(tl.minimum(raw + OFFSET, LARGEST)), mask=on)


@triton.jit
@no_type_check
def colour_layers(geometry, bands, c_direction, c_geometry, c1, OPERAND: tl.constexpr, PRODUCT: tl.constexpr):
    """Activations of the colour network's two hidden layers."""
    first = multiply(bands, tl.trans(c_direction), OPERAND, PRODUCT)
    first = tl.maximum(first + multiply(geometry, tl.trans(c_geometry), OPERAND, PRODUCT), 0.0)
    return first, tl.maximum(multiply(first, tl.trans(c1), OPERAND, PRODUCT), 0.0)


@triton.jit
@no_type_check
def load_bands(harmonics, ray, i, on):
    """Harmonics of the samples' directions [B, 16]."""
    column = tl.arange(0, HARMONICS)[None, :]
    direction = tl.load(ray + i, mask=on, other=0)
    return tl.load(harmonics + direction[:, None] * HARMONICS + column, mask=on[:, None], other=0.0)


@triton.jit
@no_type_check
def colour_kernel(
    encoded,
    source,
    ray,
    harmonics,
    networks,
    count,
    geometry_out,
    colour,
    variance,
    room,
    E: tl.constexpr,
    W: tl.constexpr,
    G: tl.constexpr,
    K: tl.constexpr,
    EP: tl.constexpr,
    WP: tl.constexpr,
    GP: tl.constexpr,
    OPERAND: tl.constexpr,
    PRODUCT: tl.constexpr,
    B: tl.constexpr,
):
    """Geometry features, colour and colour variance of the samples that light reaches."""
    begin, n = tl.program_id(0) * B, tl.load(count)
    if begin >= n:
        return
    i = begin + tl.arange(0, B)
    on = i < n
    colour_at = networks + W * E + G * W
    out_at = colour_at + W * (K + G) + W * W
    x = load_rows(encoded, tl.load(source + i, mask=on, other=0), on, room, E, EP)
    d0 = load_matrix(networks, W, E, E, WP, EP)
    hidden = tl.maximum(multiply(x, tl.trans(d0), OPERAND, PRODUCT), 0.0)
    d1 = load_matrix(networks + W * E, G, W, W, GP, WP)
    geometry = multiply(hidden, tl.trans(d1), OPERAND, PRODUCT)
    store_rows(geometry_out, geometry, i, on, room, G, GP)
    unit, feature = tl.arange(0, WP), tl.arange(0, GP)
    v_hidden = tl.load(out_at + 3 * W + unit, mask=unit < W, other=0.0)
    v_geometry = tl.load(out_at + 3 * W + W + feature, mask=feature < G, other=0.0)
    raw = tl.sum(hidden * v_hidden[None, :], 1) + tl.sum(geometry * v_geometry[None, :], 1)
    softplus = tl.maximum(raw, 0.0) + tl.log(1 + tl.exp(-tl.abs(raw)))
    tl.store(variance + i, softplus + FLOOR, mask=on)
    _, second = colour_layers(
        geometry,
        load_bands(harmonics, ray, i, on),
        load_matrix(colour_at, W, K, K + G, WP, HARMONICS),
        load_matrix(colour_at + K, W, G, K + G, WP, GP),
        load_matrix(colour_at + W * (K + G), W, W, W, WP, WP),
        OPERAND,
        PRODUCT,
    )
    logits = multiply(second, tl.trans(load_matrix(out_at, 3, W, W, 16, WP)), OPERAND, PRODUCT)
    store_rows(colour, tl.sigmoid(logits), i, on, room, 3, 16)


@triton.jit
@no_type_check
def colour_backward_kernel(
    geometry_in,
    ray,
    harmonics,
    networks,
    count,
    to_logits,
    to_geometry,
    to_harmonics,
    partial_gradients,
    room,
    parameters,
    E: tl.constexpr,
    W: tl.constexpr,
    G: tl.constexpr,
    K: tl.constexpr,
    EP: tl.constexpr,  # noqa: ARG001
    WP: tl.constexpr,
    GP: tl.constexpr,
    OPERAND: tl.constexpr,
    PRODUCT: tl.constexpr,
    LEARN: tl.constexpr,
    RAYS: tl.constexpr,
    B: tl.constexpr,
):
    """Gradient to the geometry features, the colour network (LEARN) and the harmonics (RAYS).

    Activations are computed once more, which is cheaper than keeping them; each program sums its own samples.
    """
    colour_at = networks + W * E + G * W
    out_at = colour_at + W * (K + G) + W * W
    c_direction = load_matrix(colour_at, W, K, K + G, WP, HARMONICS)
    c_geometry = load_matrix(colour_at + K, W, G, K + G, WP, GP)
    c1 = load_matrix(colour_at + W * (K + G), W, W, W, WP, WP)
    c2 = load_matrix(out_at, 3, W, W, 16, WP)
    if LEARN:
        g_direction, g_geometry = tl.zeros([WP, HARMONICS], tl.float32), tl.zeros([WP, GP], tl.float32)
        g_c1, g_c2 = tl.zeros([WP, WP], tl.float32), tl.zeros([16, WP], tl.float32)
    n = tl.load(count)
    for begin in range(tl.program_id(0) * B, n, tl.num_programs(0) * B):
        i = begin + tl.arange(0, B)
        on = i < n
        geometry = load_rows(geometry_in, i, on, room, G, GP)
        bands = load_bands(harmonics, ray, i, on)
        first, second = colour_layers(geometry, bands, c_direction, c_geometry, c1, OPERAND, PRODUCT)
        g_logits = load_rows(to_logits, i, on, room, 3, 16)
        g_second = tl.where(second > 0, multiply(g_logits, c2, OPERAND, PRODUCT), 0.0)
        g_first = tl.where(first > 0, multiply(g_second, c1, OPERAND, PRODUCT), 0.0)
        store_rows(to_geometry, multiply(g_first, c_geometry, OPERAND, PRODUCT), i, on, room, G, GP)
        if RAYS:
            g_bands = multiply(g_first, c_direction, OPERAND, PRODUCT)
            store_rows(to_harmonics, g_bands, i, on, room, HARMONICS, HARMONICS)
        if LEARN:
            g_direction += multiply(tl.trans(g_first), bands, OPERAND, PRODUCT)
            g_geometry += multiply(tl.trans(g_first), geometry, OPERAND, PRODUCT)
            g_c1 += multiply(tl.trans(g_second), first, OPERAND, PRODUCT)
            g_c2 += multiply(tl.trans(g_logits), second, OPERAND, PRODUCT)
    if LEARN:
        mine = partial_gradients + tl.program_id(0) * parameters + W * E + G * W
        store_matrix(mine, g_direction, W, K, K + G, WP, HARMONICS)
        store_matrix(mine + K, g_geometry, W, G, K + G, WP, GP)
        store_matrix(mine + W * (K + G), g_c1, W, W, W, WP, WP)
        store_matrix(mine + W * (K + G) + W * W, g_c2, 3, W, W, 16, WP)


@triton.jit
@no_type_check
def density_backward_kernel(
    encoded,
    source,
    geometry_in,
    networks,
    count,
    to_geometry,
    to_log_density,
    to_variance,
    to_encoded,
    partial_gradients,
    room,
    parameters,
    E: tl.constexpr,
    W: tl.constexpr,
    G: tl.constexpr,
    K: tl.constexpr,
    EP: tl.constexpr,
    WP: tl.constexpr,
    GP: tl.constexpr,
    OPERAND: tl.constexpr,
    PRODUCT: tl.constexpr,
    LEARN: tl.constexpr,
    TEACH: tl.constexpr,
    B: tl.constexpr,
):
    """Gradient to the encoding and, with LEARN, to the density network and the variance head.

    Unless TEACH, the head's inputs count as given: its loss does not reach the trunk.
    """
    out_at = W * E + G * W + W * (K + G) + W * W
    d0 = load_matrix(networks, W, E, E, WP, EP)
    d1 = load_matrix(networks + W * E, G, W, W, GP, WP)
    unit, feature = tl.arange(0, WP), tl.arange(0, GP)
    v_hidden = tl.load(networks + out_at + 3 * W + unit, mask=unit < W, other=0.0)
    v_geometry = tl.load(networks + out_at + 3 * W + W + feature, mask=feature < G, other=0.0)
    if LEARN:
        g_d0, g_d1 = tl.zeros([WP, EP], tl.float32), tl.zeros([GP, WP], tl.float32)
        g_v_hidden, g_v_geometry = tl.zeros([WP], tl.float32), tl.zeros([GP], tl.float32)
    n = tl.load(count)
    for begin in range(tl.program_id(0) * B, n, tl.num_programs(0) * B):
        i = begin + tl.arange(0, B)
        on = i < n
        x = load_rows(encoded, tl.load(source + i, mask=on, other=0), on, room, E, EP)
        hidden = tl.maximum(multiply(x, tl.trans(d0), OPERAND, PRODUCT), 0.0)
        g_geometry = load_rows(to_geometry, i, on, room, G, GP)
        g_density = tl.load(to_log_density + i, mask=on, other=0.0)
        g_geometry += tl.where(feature[None, :] == 0, g_density[:, None], 0.0)
        if LEARN or TEACH:
            geometry = load_rows(geometry_in, i, on, room, G, GP).to(tl.float32)
            raw = tl.sum(hidden * v_hidden[None, :], 1) + tl.sum(geometry * v_geometry[None, :], 1)
            g_raw = tl.load(to_variance + i, mask=on, other=0.0) * tl.sigmoid(raw)
        if LEARN:
            g_v_hidden += tl.sum(g_raw[:, None] * hidden, 0)
            g_v_geometry += tl.sum(g_raw[:, None] * geometry, 0)
        if TEACH:
            g_geometry += g_raw[:, None] * v_geometry[None, :]
        g_hidden = multiply(g_geometry, d1, OPERAND, PRODUCT)
        if TEACH:
            g_hidden += g_raw[:, None] * v_hidden[None, :]
        g_hidden = tl.where(hidden > 0, g_hidden, 0.0)
        store_rows(to_encoded, multiply(g_hidden, d0, OPERAND, PRODUCT), i, on, room, E, EP)
        if LEARN:
            g_d0 += multiply(tl.trans(g_hidden), x, OPERAND, PRODUCT)
            g_d1 += multiply(tl.trans(g_geometry), hidden, OPERAND, PRODUCT)
    if LEARN:
        mine = partial_gradients + tl.program_id(0) * parameters
        store_matrix(mine, g_d0, W, E, E, WP, EP)
        store_matrix(mine + W * E, g_d1, G, W, W, GP, WP)
        tl.store(mine + out_at + 3 * W + unit, g_v_hidden, mask=unit < W)
        tl.store(mine + out_at + 3 * W + W + feature, g_v_geometry, mask=feature < G)
