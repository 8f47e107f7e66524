"""Code for one row or one tile of nodes: vector instructions, templates that are built from them, and their
compilation.
"""
