"""Straight-line text to machine code, by LLVM."""
