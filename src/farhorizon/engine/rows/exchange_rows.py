"""The exchange of halos with other processes. This text is a template like those of stencils, though without settings:
`engine.rows.build` writes it out for runs on several processes.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.exchanges import EXCHANGE_SIGNATURE, exchange_halos


@cfunc(EXCHANGE_SIGNATURE)
def exchange(table, array, components, apart):
    """Fill halos by the messages of a table."""
    exchange_halos(table, array, components, apart)
