"""What the exports of latent diffusion models in `panorama` and `insert` share."""

import torch


class PlainAttention:
    """Attention in products and a softmax. The plain processor of `diffusers` adds an empty matrix of the size of the scores, which
    becomes a constant of the graph (2 GB at 1024 x 512); the fused one is not for every runtime."""

    def __call__(self, attn, hidden_states, encoder_hidden_states=None, attention_mask=None, temb=None):
        assert attention_mask is None and attn.spatial_norm is None
        x, residual = hidden_states, hidden_states
        shape = x.shape
        if len(shape) == 4:
            x = x.flatten(2).transpose(1, 2)
        if attn.group_norm is not None:
            x = attn.group_norm(x.transpose(1, 2)).transpose(1, 2)
        context = x if encoder_hidden_states is None else encoder_hidden_states
        heads = lambda v: v.unflatten(2, (attn.heads, -1)).transpose(1, 2)
        q, k, v = heads(attn.to_q(x)), heads(attn.to_k(context)), heads(attn.to_v(context))
        weights = torch.softmax(q @ k.transpose(2, 3) * attn.scale, 3)
        x = attn.to_out[0]((weights @ v).transpose(1, 2).flatten(2))
        if len(shape) == 4:
            x = x.transpose(1, 2).reshape(shape)
        if attn.residual_connection:
            x = x + residual
        return x / attn.rescale_output_factor


def plain(model):
    """Gives every attention of a model of `diffusers` the plain one."""
    for part in model.modules():
        if hasattr(part, "set_attn_processor"):
            part.set_attn_processor(PlainAttention())
    return model
