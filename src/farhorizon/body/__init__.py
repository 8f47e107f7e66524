"""Correspondence elasticity with damage, `fh.Body`."""
