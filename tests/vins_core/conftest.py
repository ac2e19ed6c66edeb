from sample import sample_run

__all__ = ["sample_run"]
