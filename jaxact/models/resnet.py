"""A residual network with group normalisation, for images that three convolutions are too few for.

Group normalisation does not mix the lanes of a batch, so what a lane does is its own whatever its
neighbours see.
"""

from __future__ import annotations

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.models.convolution import Convolution
from jaxact.models.encoders import RELU, scaled


class ResNet(nn.Module):
    """ResNet with group normalisation (Wu & He 2018), as DD-PPO's (Wijmans et al. 2020).

    A 7×7 stem and a pooling layer, both of stride 2; groups of basic blocks, all but the first
    beginning with stride 2; a 3×3 compression; a dense layer. With blocks (2, 2, 2, 2) it is
    ResNet-18 at half its width.

    Attributes:
      features: size of the result.
      channels: of the first group of blocks; each group has twice those of the one before.
      blocks: basic blocks of each group.
      groups: of the normalisation; divides `channels`.
      compressed: channels of the compression.
    """

    features: int = 512
    channels: int = 32
    blocks: Sequence[int] = (2, 2, 2, 2)
    groups: int = 16
    compressed: int = 128

    @nn.compact
    def __call__(self, image: jax.Array) -> jax.Array:
        """Maps [..., H, W, C], H and W at least 16, to float32 [..., features]."""
        lead = image.shape[:-3]
        x = scaled(image).reshape((-1, *image.shape[-3:]))
        x = Convolution(self.channels, 7, 2, padding=3, use_bias=False)(x)
        x = nn.relu(nn.GroupNorm(self.groups)(x))
        x = nn.max_pool(x, (3, 3), (2, 2), ((1, 1), (1, 1)))
        for group, blocks in enumerate(self.blocks):
            for block in range(blocks):
                stride = 2 if group > 0 and block == 0 else 1
                x = BasicBlock(self.channels * 2**group, stride, self.groups)(x)
        x = Convolution(self.compressed, 3, padding=1, use_bias=False)(x)
        x = nn.relu(nn.GroupNorm(1)(x))
        x = x.reshape((*lead, -1))
        return nn.relu(nn.Dense(self.features, kernel_init=RELU)(x))


class BasicBlock(nn.Module):
    """Two 3×3 convolutions and a shortcut (He et al. 2016), each normalised by groups.

    Attributes:
      channels: output channels.
      stride: of the first convolution and of the shortcut.
      groups: of the normalisation.
    """

    channels: int
    stride: int
    groups: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Maps float32 [N, H, W, C] to [N, h, w, channels]."""
        y = Convolution(self.channels, 3, self.stride, padding=1, use_bias=False)(x)
        y = nn.relu(nn.GroupNorm(self.groups)(y))
        y = Convolution(self.channels, 3, padding=1, use_bias=False)(y)
        y = nn.GroupNorm(self.groups)(y)
        if x.shape != y.shape:
            x = Convolution(self.channels, 1, self.stride, use_bias=False)(x)
            x = nn.GroupNorm(self.groups)(x)
        return nn.relu(jnp.add(x, y))
