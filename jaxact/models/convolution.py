"""A convolution whose gradient stays fast inside a scan.

XLA:CPU leaves its fast path for gradients of convolutions within loops (jax issue 12868), where all
of training happens. Here the kernel's gradient is a sum of matrix products instead, and the image's
a plain convolution, which is 15 to 40 times faster. An image of no more cells than the kernel is
mapped by one matrix, which is no more work and several times faster.
"""

from __future__ import annotations

from functools import partial

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

_LAYOUT = ("NHWC", "HWIO", "NHWC")


@partial(jax.custom_vjp, nondiff_argnums=(2,))
def convolve(x: jax.Array, kernel: jax.Array, stride: int) -> jax.Array:
    """Valid convolution of x [N, H, W, I] with kernel [k, k, I, O] -> [N, h, w, O]."""
    return jax.lax.conv_general_dilated(
        x, kernel, (stride, stride), "VALID", dimension_numbers=_LAYOUT
    )


def _forward(
    x: jax.Array, kernel: jax.Array, stride: int
) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    return convolve(x, kernel, stride), (x, kernel)


def _backward(
    stride: int, saved: tuple[jax.Array, jax.Array], g: jax.Array
) -> tuple[jax.Array, jax.Array]:
    x, kernel = saved
    rows, columns = kernel.shape[:2]
    h, w = g.shape[1:3]

    def window(i: int, j: int) -> jax.Array:
        stops = (x.shape[0], i + stride * (h - 1) + 1, j + stride * (w - 1) + 1, x.shape[3])
        return jax.lax.slice(x, (0, i, j, 0), stops, (1, stride, stride, 1))

    g_kernel = jnp.stack(
        [
            jnp.stack([jnp.einsum("bhwi,bhwo->io", window(i, j), g) for j in range(columns)])
            for i in range(rows)
        ]
    )
    return _image_gradient(g, kernel, stride, x.shape[1], x.shape[2]), g_kernel


def _image_gradient(
    g: jax.Array, kernel: jax.Array, stride: int, rows: int, columns: int
) -> jax.Array:
    """Returns the gradient [N, rows, columns, I] of `convolve` by its images.

    Cells that lie as far into a stride are reached by the same taps of the kernel, so that one
    convolution of stride 1, with a kernel of ⌈k / stride⌉² taps, gives them all; no zeros are put
    between the entries of g.
    """
    size, _, channels, features = kernel.shape
    taps = -(-size // stride)
    blocks = -(-rows // stride), -(-columns // stride)
    missing = taps * stride - size
    kernel = jnp.pad(kernel, ((0, missing), (0, missing), (0, 0), (0, 0)))
    kernel = kernel.reshape(taps, stride, taps, stride, channels, features)[::-1, :, ::-1]
    kernel = kernel.transpose(0, 2, 5, 1, 3, 4).reshape(taps, taps, features, -1)
    edges = [
        (taps - 1, have - reached, 0) for have, reached in zip(blocks, g.shape[1:3], strict=True)
    ]
    # Some cells at the end may be reached by nothing, or blocks by no window: the last are cut off.
    g = jax.lax.pad(g, jnp.zeros((), g.dtype), ((0, 0, 0), *edges, (0, 0, 0)))
    # Were the padding made a part of the convolution, that would leave the fast path again.
    g = jax.lax.optimization_barrier(g)
    y = jax.lax.conv_general_dilated(g, kernel, (1, 1), "VALID", dimension_numbers=_LAYOUT)
    y = y.reshape(-1, *blocks, stride, stride, channels).transpose(0, 1, 3, 2, 4, 5)
    y = y.reshape(-1, blocks[0] * stride, blocks[1] * stride, channels)
    return y[:, :rows, :columns]


convolve.defvjp(_forward, _backward)


def convolution_matrix(
    kernel: jax.Array, rows: int, columns: int, stride: int, padding: int
) -> jax.Array:
    """Lays a convolution out as the linear map that it is on images of one size.

    Args:
      kernel: [k, k, I, O].
      rows, columns: size of the images.
      stride: step of the window.
      padding: zeros on each side of the image.

    Returns:
      [rows · columns · I, h · w · O], from images to results, both laid out as vectors.
    """
    size, _, channels, features = kernel.shape

    def taps(side: int) -> np.ndarray:
        """Which of the kernel's rows or columns takes [input] to [output], if it has it."""
        reached = np.arange(_windows(side, size, stride, padding))
        return np.arange(side)[:, None] + padding - stride * reached

    row, column = taps(rows)[:, None, :, None], taps(columns)[None, :, None, :]
    both = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    # Behind the kernel's blocks one of zeros, for where it does not reach.
    places = np.where(both, size * row + column, size * size)
    blocks = jnp.concatenate(
        [kernel.reshape(-1, channels, features), jnp.zeros((1, channels, features), kernel.dtype)]
    )[places.reshape(rows * columns, -1)]
    return blocks.transpose(0, 2, 1, 3).reshape(rows * columns * channels, -1)


def _windows(side: int, size: int, stride: int, padding: int) -> int:
    """Returns how many windows there are along a side."""
    return (side + 2 * padding - size) // stride + 1


class Convolution(nn.Module):
    """Convolution, NHWC.

    Attributes:
      features: output channels.
      size: side of the square kernel.
      stride: step of the window.
      padding: zeros on each side of the image.
      use_bias: whether a bias is added.
    """

    features: int
    size: int
    stride: int = 1
    padding: int = 0
    use_bias: bool = True

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Maps float32 [..., H, W, C] to [..., h, w, features]."""
        kernel = self.param(
            "kernel",
            nn.initializers.he_normal(),
            (self.size, self.size, x.shape[-1], self.features),
            jnp.float32,
        )
        flat = x.reshape((-1, *x.shape[-3:]))
        rows, columns = flat.shape[1:3]
        if rows * columns <= self.size**2:
            matrix = convolution_matrix(kernel, rows, columns, self.stride, self.padding)
            h, w = (_windows(n, self.size, self.stride, self.padding) for n in (rows, columns))
            y = (flat.reshape(flat.shape[0], -1) @ matrix).reshape(-1, h, w, self.features)
        else:
            sides = (self.padding, self.padding)
            y = convolve(jnp.pad(flat, ((0, 0), sides, sides, (0, 0))), kernel, self.stride)
        if self.use_bias:
            y = y + self.param("bias", nn.initializers.zeros, (self.features,), jnp.float32)
        return y.reshape(x.shape[:-3] + y.shape[1:])
