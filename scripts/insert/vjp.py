"""The vector-Jacobian product of an encoder as an ONNX graph: what `encoder_vjp` of a guidance bundle is."""

import torch
from torch.fx.experimental.proxy_tensor import make_fx
from torch._decomp import get_decompositions

#: Backward operators that the exporter does not know, taken apart into ones that it does.
DECOMPOSED = [
    torch.ops.aten.convolution_backward, torch.ops.aten.native_group_norm_backward, torch.ops.aten.slice_backward,
    torch.ops.aten.select_backward, torch.ops.aten.silu_backward, torch.ops.aten.native_group_norm,
    torch.ops.aten._softmax_backward_data, torch.ops.aten.upsample_nearest2d_backward,
]


def conv_backward(grad, x, weight, bias_sizes, stride, padding, dilation, transposed, output_padding, groups, mask):
    """aten.convolution_backward with respect to the input alone, as a transposed convolution."""
    assert not transposed and all(d == 1 for d in dilation)
    rest = [
        (n + 2 * p - k) % s for n, p, k, s in zip(x.shape[2:], padding, weight.shape[2:], stride)
    ]
    out = torch.nn.functional.conv_transpose2d(grad, weight, None, stride, padding, rest, groups)
    return out, None, None


def vjp_module(encode, picture, latent):
    """A module (picture, grad_latent) -> grad_picture, traced for these shapes."""

    def vjp(x, g):
        x = x.detach().requires_grad_(True)
        return torch.autograd.grad(encode(x), x, g)[0]

    table = get_decompositions(DECOMPOSED)
    table[torch.ops.aten.convolution_backward.default] = conv_backward
    return make_fx(vjp, decomposition_table=table)(picture, latent)


def export(module, example, path, inputs, output):
    program = torch.onnx.export(
        module, example, dynamo=True, opset_version=18, input_names=inputs, output_names=[output], verbose=False
    )
    program.save(path, external_data=False)
