"""Pictures and replays of impacts and motions; matplotlib and meshcat are imported only when used."""
