"""Margins for rounding in double precision, whose numbers have 16 digits, of which long sums lose some."""

TINY = 1e-300  # stands for zero in a denominator or a logarithm: smaller than all that is computed, yet not denormal
MARGIN = 1e-9  # of counts and places from decimals, which rounding changes by 1e-15 or so, and intent by much more
EQUAL = 1e-12  # relative to the largest: entries of a matrix that differ by less, after sums of thousands, are equal
