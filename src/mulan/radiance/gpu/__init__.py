"""The radiance field on an NVIDIA GPU, in Triton; nothing here is imported where Triton is not installed."""
