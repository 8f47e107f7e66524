"""The exchange of halos with other processes. This module is a template like those of stencils, but without settings:
`engine.rows.build` writes it out for runs on several processes.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.exchanges import EXCHANGE_SIGNATURE, move_messages, receive_values, send_values


@cfunc(EXCHANGE_SIGNATURE)
def send(table, array, components, apart):
    """Begin the messages of a table."""
    send_values(table, array, components, apart)


@cfunc(EXCHANGE_SIGNATURE)
def receive(table, array, components, apart):
    """End the messages of a table, and fill halos with them."""
    receive_values(table, array, components, apart)


@cfunc(EXCHANGE_SIGNATURE)
def move(table, array, components, apart):
    """Let the messages of a table progress."""
    move_messages(table, array, components, apart)
