"""The kernels, written in the language: what a ray meets, and what colour it brings back."""
