"""Problems in unbounded media with known exact solutions."""
