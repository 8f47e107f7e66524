"""Problems of unbounded media whose exact solutions are known."""
