"""Code for one row or one tile of nodes: vector instructions, the templates that are made of them, and their
compilation.
"""
