"""Straight-line text to machine code by LLVM: the only door to it."""
