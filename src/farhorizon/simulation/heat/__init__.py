"""A temperature beside a solid, and metal beside liquid."""
