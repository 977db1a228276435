"""Transient rows: work of a lot, orders to stations, jobs of pages, outgoing events, the session of a line.

Each is a table of its own, since each answers another question when its holder dies. Work is handed
to the next worker when its lease ends, three times. An order is never done again: nothing moves
because of an old order, and one run a station is a unique index. A job ends as an error that a
person sees. A destination has no items at all, only a cursor into the audit trail that another
process takes over. What they share is short transactions beside the audit chain, done again where
the connection was cut.
"""
