from chromium import browser, open_page, run_folder, serve, served_run

__all__ = ["browser", "open_page", "run_folder", "serve", "served_run"]
