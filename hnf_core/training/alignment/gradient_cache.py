"""Gradients of a large contrastive batch in the memory of a small one (Gao et al. 2021, "Scaling deep contrastive
learning batch size under memory limited setup").

The loss couples all rows, but only through their embeddings. So: embed chunk by chunk without a graph; take the loss's
gradient with respect to the embeddings of the whole batch; embed each chunk once more, with a graph, and send its share
of that gradient down. One forward pass more than the plain batch costs, and the graph of one chunk at a time.

Batch normalisation knows its chunk only, in both passes alike (the "ghost batch" of Hoffer et al. 2017): what comes out
are exactly the gradients of a plain batch whose chunks are embedded one by one, and with normalisation that does not
look at the batch (frozen statistics, groups) those of the plain batch itself. Running statistics move once for each
chunk, in the second pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

Loss = Callable[..., Tensor]


def backward_with_gradient_cache(
    encoders: Sequence[nn.Module], inputs: Sequence[Tensor], loss: Loss, chunk: int
) -> Tensor:
    """Add the gradients of loss(encoders[0](inputs[0]), encoders[1](inputs[1]), …) to the encoders' parameters and
    return the loss, detached.

    inputs: (n, …) each. chunk: rows that are embedded at once. Encoders must give the same answer twice (no dropout).
    """
    embedded = []
    with torch.no_grad():
        for encoder, batch in zip(encoders, inputs, strict=True):
            with freeze_running_statistics(encoder):
                embedded.append(torch.cat([encoder(part) for part in torch.split(batch, chunk)]))
    leaves = [each.requires_grad_() for each in embedded]
    value = loss(*leaves)
    gradients = torch.autograd.grad(value, leaves)
    for encoder, batch, gradient in zip(encoders, inputs, gradients, strict=True):
        for part, share in zip(torch.split(batch, chunk), torch.split(gradient, chunk), strict=True):
            encoder(part).backward(share)
    return value.detach()


def backward_reference(encoders: Sequence[nn.Module], inputs: Sequence[Tensor], loss: Loss, chunk: int) -> Tensor:
    """What cached_backward computes, the plain way: one graph over all chunks."""
    value = loss(
        *(
            torch.cat([encoder(part) for part in torch.split(batch, chunk)])
            for encoder, batch in zip(encoders, inputs, strict=True)
        )
    )
    value.backward()  # type: ignore[no-untyped-call]
    return value.detach()


@contextmanager
def freeze_running_statistics(network: nn.Module) -> Iterator[None]:
    """Batch normalisation as in training, but its running statistics stay as they are."""
    tracking = [each for each in network.modules() if isinstance(each, _BatchNorm) and each.track_running_stats]
    training = [each for each in tracking if each.training]
    for each in training:
        each.track_running_stats = False
    try:
        yield
    finally:
        for each in training:
            each.track_running_stats = True
