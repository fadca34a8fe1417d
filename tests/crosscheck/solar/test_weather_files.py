"""Weather files in the layouts that pvlib documents, and what is wrong with others."""

import json

import numpy as np
import pandas as pd
import pvlib
import pytest
import synthetic_weather as synthetic

from crosscheck.solar.place import Place
from crosscheck.solar.weather import clear_sky
from crosscheck.solar.weather_files import read_weather
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.source_file import SourceError

PLACE = Place(synthetic.LATITUDE, synthetic.LONGITUDE, synthetic.ALTITUDE)

SAMPLES = {
    "tmy3.csv": (synthetic.tmy3, "TMY3", 8760),
    "town.epw": (synthetic.epw, "EPW", 8760),
    "nsrdb.csv": (synthetic.nsrdb, "NSRDB", 17520),
    "typical.csv": (synthetic.pvgis_typical, "PVGIS typical year", 8760),
    "typical.json": (synthetic.pvgis_typical_json, "PVGIS typical year", 8760),
    "hourly.csv": (synthetic.pvgis_hourly, "PVGIS hourly", 8784),  # of a leap year
    "hourly.json": (synthetic.pvgis_hourly_json, "PVGIS hourly", 8784),
}
"""Writer, format and number of rows by the name of a file, which does not decide the format."""


@pytest.fixture(scope="module")
def samples():
    """Text and weather of each file of `SAMPLES`, by its name."""
    return {name: write() for name, (write, _, _) in SAMPLES.items()}


def refusal(path, text, **options):
    """What is wrong with a file with this text."""
    path.write_text(text)
    with pytest.raises(SourceError) as caught:
        read_weather(str(path), **options)
    assert caught.value.path == str(path)
    return caught.value.problem


@pytest.mark.parametrize("name", SAMPLES)
def test_weather_is_that_of_the_middle_of_each_interval(tmp_path, samples, name):
    """The sky of the files is that of the middles of hours, or of the times of images."""
    path, (text, expected) = tmp_path / f"{name}.txt", samples[name]
    path.write_text(text)
    weather, (_, kind, count) = read_weather(str(path)), SAMPLES[name]
    assert weather.source.startswith(f"{kind} file {path}")
    assert (weather.place, len(weather.times)) == (PLACE, count)
    assert round(count * weather.step) in (8760, 8784)
    apart = (weather.times - expected.index).total_seconds().to_numpy()
    assert np.max(np.abs(apart)) < 1e-3
    for quantity, tolerance in (("ghi", 1.0), ("dhi", 0.0), ("temperature", 0.0), ("wind", 0.0)):
        column = {"temperature": "temp_air", "wind": "wind_speed"}.get(quantity, quantity)
        assert np.max(np.abs(getattr(weather, quantity) - expected[column])) <= tolerance
    high = np.sin(weather.sun().elevation) > 0.1  # PVGIS rounds the elevation in hourly files
    assert np.max(np.abs(weather.dni - expected["dni"])[high]) < 0.5


def test_sums_are_those_that_pvlib_reads(tmp_path, samples):
    path = tmp_path / "tmy3.csv"
    path.write_text(samples["tmy3.csv"][0])
    data, _ = pvlib.iotools.read_tmy3(path)
    weather = read_weather(str(path))
    assert weather.irradiation(weather.ghi) == pytest.approx(data["ghi"].sum() / 1000.0, rel=1e-12)
    assert weather.irradiation(weather.dni) == pytest.approx(data["dni"].sum() / 1000.0, rel=1e-12)
    assert weather.months[0] == 1
    assert weather.months[-1] == 12


def test_files_that_come_with_pvlib_are_read():
    """Greensboro, North Carolina; sums of the file's own columns."""
    path = pvlib.__path__[0] + "/data/723170TYA.CSV"
    weather, raw = read_weather(path), pd.read_csv(path, skiprows=1)
    assert weather.irradiation(weather.ghi) == pytest.approx(raw["GHI (W/m^2)"].sum() / 1000.0)
    assert str(weather.times[0]) == "1988-01-01 00:30:00-05:00"


def test_epw_of_pvgis_is_in_utc_with_the_offset_of_its_comment(tmp_path):
    """The header names another zone; hours of EPW end 1 h after they begin: 1 - 0.8239 h."""
    text, expected = synthetic.epw(zone=1.0, comment="Irradiance Time Offset (h):-0.8239", shift=0.1761)
    path = tmp_path / "pvgis.epw"
    path.write_text(text)
    apart = (read_weather(str(path)).times - expected.index).total_seconds()
    assert np.max(np.abs(apart)) < 1e-3


@pytest.mark.slow
def test_one_year_of_several_is_chosen(tmp_path):
    path = tmp_path / "years.csv"
    path.write_text(synthetic.pvgis_hourly("2014-01-01", "2015-01-01")[0])
    with pytest.raises(CrosscheckError, match="years 2014 to 2015; choose one with --year"):
        read_weather(str(path))
    weather = read_weather(str(path), year=2014)
    assert set(weather.times.year) == {2014}
    for year, count in ((2015, 24), (2016, 0)):
        with pytest.raises(SourceError, match=f"has {count} rows of {year}; needed: 87"):
            read_weather(str(path), year=year)


def test_typical_years_are_no_calendar_years(tmp_path, samples):
    path = tmp_path / "tmy3.csv"
    path.write_text(samples["tmy3.csv"][0])
    with pytest.raises(CrosscheckError, match="--year 2015"):
        read_weather(str(path), year=2015)


@pytest.mark.slow
def test_a_wrong_time_zone_is_found(tmp_path, samples):
    """The header has 5 hours too much; the remedy reads the same sums."""
    path, (text, expected) = tmp_path / "tmy3.csv", samples["tmy3.csv"]
    wrong = text.replace(",XX,-1.0,", ",XX,4.0,")
    assert refusal(path, wrong).endswith("in the zone UTC+4; --zone UTC-01:00 fits (0.1 %)")
    weather = read_weather(str(path), zone="UTC-01:00")
    assert np.max(np.abs((weather.times - expected.index).total_seconds())) < 1e-3
    # half an hour is found, too
    assert "--zone UTC-01:00 fits" in refusal(path, text.replace(",XX,-1.0,", ",XX,-1.5,"))
    with pytest.raises(CrosscheckError, match="time zone 'Nowhere'"):
        read_weather(str(path), zone="Nowhere")


def changed(text, line, change):
    """Text with another line (from 1): `change` maps the old one to the new one, None to leave it out."""
    lines = text.split("\n")
    lines[line - 1 : line] = [] if change is None else [change(lines[line - 1])]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("name", "line", "change", "problem"),
    [
        ("tmy3.csv", 40, lambda row: row.replace(":00,", ":00,x", 1), "line 40: GHI (W/m^2) is 'x"),
        ("tmy3.csv", 40, lambda row: row + ",1", "line 40: has 9 cells; needed: 8"),
        ("tmy3.csv", 40, None, "line 40: 01/02/2003 15:00 is 2 h after the row before; needed: 1 h after"),
        ("tmy3.csv", 40, lambda row: row.replace("01/02", "02/31"), "line 40: '02/31/2003 14:00' is no time"),
        ("tmy3.csv", 2, lambda row: row.replace("DNI", "BNI"), "line 2: no column 'DNI (W/m^2)', but Date"),
        ("tmy3.csv", 8762, None, "has 8759 rows 1 h apart; needed: the 8760 hours of a year"),
        ("tmy3.csv", 40, lambda row: "", "line 40: is empty; needed: a row for each hour"),
        ("tmy3.csv", 1, lambda row: row.replace("-1.0", "west"), "pvlib cannot read it as TMY3: could not"),
        ("tmy3.csv", 1, lambda row: row.replace("37.4", "137.4"), "header: latitude 137.4 is off the globe"),
        (
            "town.epw",
            40,
            lambda row: row.replace(",9999,9999,300,", ",9999,9999,300,99990"),
            "line 40: global hor",
        ),
        ("town.epw", 40, lambda row: row[:30], "line 40: has 10 cells; needed: 22 or more"),
        ("town.epw", 8, lambda row: row.replace("1,1", "1,4"), "line 8: needed: 'DATA PERIODS,1,1,...'"),
        ("nsrdb.csv", 40, None, "line 40: 2020 1 1 18 30 is 1 h after the row before; needed: 0.5 h after"),
        ("typical.csv", 40, None, "line 40: 20070101:2200 is 2 h after the row before; needed: 1 h after"),
        ("typical.csv", 40, lambda row: row.replace("60.0,", "60.0,-9"), "line 40: G(h) is -9"),
        (
            "hourly.csv",
            9,
            lambda row: row.replace("Gb(i)", "G(i)"),
            "line 9: no column 'Gb(i)', but time, G(i)",
        ),
        (
            "hourly.csv",
            7,
            lambda row: row.replace("0 deg", "30 deg"),
            "slope of the plane is 30 deg.; needed: 0",
        ),
    ],
)
def test_files_are_refused_by_line_and_column(tmp_path, samples, name, line, change, problem):
    text = samples[name][0].replace("\r\n", "\n")
    assert refusal(tmp_path / name, changed(text, line, change)).startswith(problem)


def test_files_of_other_formats_are_refused(tmp_path, samples):
    path = tmp_path / "other"
    for text in ("", "<html>", "time,speed\n0,1\n", "{", "[1]", '{"outputs": 1}', '{"outputs": {}}'):
        assert "PVGIS (typical year or hourly)" in refusal(path, text)
    content = json.loads(samples["hourly.json"][0])
    del content["outputs"]["hourly"][24:]  # headers are read before rows are counted
    for inputs in (None, {}, {"location": 1}, {"location": {"latitude": "x"}}):
        assert refusal(path, json.dumps(content | {"inputs": inputs})).startswith(
            ("header: ", "pvlib cannot")
        )
    for system in (1, {"fixed": 1}, {"fixed": {"slope": {"value": 30}}}, {"two_axis": {}}):
        inputs = content["inputs"] | {"mounting_system": system}
        assert refusal(path, json.dumps(content | {"inputs": inputs})).startswith(
            ("header: ", "slope of the")
        )
    content = json.loads(samples["typical.json"][0])
    del content["outputs"]["tmy_hourly"][30]["Gb(n)"]
    assert refusal(path, json.dumps(content)) == "outputs.tmy_hourly[30]: has no 'Gb(n)'"
    assert refusal(tmp_path / "dark", samples["tmy3.csv"][0].split("\n", 1)[0] + "\n").startswith("line 1")


def test_missing_wind_and_temperature_are_known_where_they_are_needed(tmp_path, samples):
    """Marked as TMY3 does it, in one row."""
    path = tmp_path / "tmy3.csv"
    lines = samples["tmy3.csv"][0].split("\n")
    cells = lines[39].split(",")
    cells[5:7] = "-9900.0", "-9900.0"
    lines[39] = ",".join(cells)
    path.write_text("\n".join(lines))
    weather = read_weather(str(path))
    assert np.flatnonzero(np.isnan(weather.wind)).tolist() == [37]
    with pytest.raises(CrosscheckError, match="line 40: wind is missing, which --stow needs"):
        weather.complete("wind", "--stow")
    with pytest.raises(CrosscheckError, match="clear sky of 2025 has no temperature"):
        clear_sky(PLACE, 2025).complete("temperature", "this")


def test_a_clear_sky_is_that_of_pvlib():
    weather = clear_sky(PLACE, 2024, "Europe/Madrid")
    assert len(weather.times) == 2 * 8784  # hours of a leap year, whatever its clocks do
    location = pvlib.location.Location(PLACE.latitude, PLACE.longitude, altitude=PLACE.altitude)
    some = weather.times[5000:5100]
    assert np.allclose(weather.dni[5000:5100], location.get_clearsky(some)["dni"], rtol=0.0, atol=1e-9)
    for year, zone in ((1600, None), (2024, "Nowhere")):
        with pytest.raises(CrosscheckError):
            clear_sky(PLACE, year, zone)
