"""Low-rank additions to the attention of a network (LoRA: Hu et al. 2022): `h = W x + A B x`, W frozen, A and B of rank r."""

import torch
from torch import nn

#: The layers that are adapted, by the end of their names.
TARGETS = ("to_q", "to_k", "to_v", "to_out.0")


class Adapted(nn.Module):
    """A linear layer and its addition; the same as the layer alone until it is trained."""

    def __init__(self, layer, rank):
        super().__init__()
        self.layer = layer.requires_grad_(False)
        like = dict(device=layer.weight.device, dtype=torch.float32)
        self.down = nn.Parameter(torch.randn(rank, layer.in_features, **like) / rank)
        self.up = nn.Parameter(torch.zeros(layer.out_features, rank, **like))

    def forward(self, x):
        return self.layer(x) + (x.to(self.down.dtype) @ self.down.T @ self.up.T).to(x.dtype)

    def merged(self):
        """The layer with its addition in the weights."""
        out = nn.Linear(self.layer.in_features, self.layer.out_features, self.layer.bias is not None)
        out = out.to(self.layer.weight.device, self.layer.weight.dtype)
        with torch.no_grad():
            out.weight.copy_(self.layer.weight + (self.up @ self.down).to(self.layer.weight.dtype))
            if self.layer.bias is not None:
                out.bias.copy_(self.layer.bias)
        return out


def each(network, kind):
    """(parent, name, layer) of the layers of a kind, as a list: they are about to be replaced."""
    found = []
    for path, layer in network.named_modules():
        if isinstance(layer, kind):
            parent, _, name = path.rpartition(".")
            found.append((network.get_submodule(parent), path, name, layer))
    return found


def add(network, rank=4):
    """Freezes a network and adapts its attention; returns the parameters to train."""
    network.requires_grad_(False)
    parameters = []
    for parent, path, name, layer in each(network, nn.Linear):
        if path.endswith(TARGETS):
            adapted = Adapted(layer, rank)
            setattr(parent, name, adapted)
            parameters += [adapted.down, adapted.up]
    if not parameters:
        raise ValueError(f"no linear layer of this network ends in one of {', '.join(TARGETS)}")
    return parameters


def merge(network):
    """Puts every addition into its layer's weights."""
    for parent, _, name, layer in each(network, Adapted):
        setattr(parent, name, layer.merged())
    return network


def weights(network):
    """The additions alone, by the name of their layer: small enough to keep."""
    return {
        f"{path}.{part}": getattr(layer, part).detach().cpu()
        for _, path, _, layer in each(network, Adapted)
        for part in ("down", "up")
    }
