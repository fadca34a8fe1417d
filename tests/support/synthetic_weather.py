"""Synthetic weather of a year, written in the layouts of weather files that pvlib documents.

The light is that of a simple sky over a place: direct light from an air mass, clouds that change from day to
day, and GHI = DNI cos(zenith) + DHI at the middle of each hour.
"""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pvlib

LATITUDE, LONGITUDE, ALTITUDE = 37.4, -6.0, 30.0
"""Place of all files: degrees north and east, m."""

HOURS = 8760
"""Number of hours of a typical year."""


def sky(middles):
    """Weather at n times (the middles of hours) with a zone: data frame of pvlib's names."""
    zenith = pvlib.solarposition.get_solarposition(
        middles, LATITUDE, LONGITUDE, ALTITUDE, method="nrel_numpy"
    )
    cosine = np.maximum(np.cos(np.radians(zenith["apparent_zenith"].to_numpy())), 0.0)
    day = middles.day_of_year.to_numpy()
    clear = 0.25 + 0.75 * np.abs(np.sin(1.7 * day))
    dni = np.where(cosine > 0.0, np.round(900.0 * clear * np.exp(-0.15 / np.maximum(cosine, 0.02))), 0.0)
    dhi = np.round(120.0 * cosine**0.7)
    hour = middles.hour.to_numpy()
    return pd.DataFrame(
        {
            "dni": dni,
            "dhi": dhi,
            "ghi": np.round(dni * cosine + dhi),
            "temp_air": np.round(
                15.0 - 8.0 * np.cos(0.0172 * day) - 5.0 * np.cos(2.0 * np.pi * hour / 24.0), 1
            ),
            "wind_speed": np.round(4.0 + 4.0 * np.sin(0.31 * day) * np.sin(2.0 * np.pi * hour / 24.0), 1),
        },
        index=middles,
    )


def typical_hours(zone, years=(2011,)):
    """Beginnings of the hours of a typical year without leap days, whose months are from years in turn."""
    parts = []
    for month in range(1, 13):
        begin = pd.Timestamp(year=years[month % len(years)], month=month, day=1, tz=zone)
        days = 28 if month == 2 else begin.days_in_month
        parts.append(pd.date_range(begin, periods=24 * days, freq="h"))
    return parts[0].append(parts[1:])


def tmy3(zone=-1.0):
    """TMY3: hours end at their time stamps, midnight is 24:00; months are of 1996 and 2003."""
    begins = typical_hours(f"UTC{int(zone):+03d}:00", (1996, 2003))
    data = sky(begins + pd.Timedelta(minutes=30))
    names = "GHI (W/m^2)", "DNI (W/m^2)", "DHI (W/m^2)", "Dry-bulb (C)", "Wspd (m/s)"
    lines = [f'722780,"SAMPLE TOWN",XX,{zone:.1f},{LATITUDE},{LONGITUDE},{ALTITUDE:.0f}']
    lines.append(",".join(["Date (MM/DD/YYYY)", "Time (HH:MM)", *names, "Pwat (cm)"]))
    for begin, row in zip(begins, data.itertuples(), strict=True):
        stamp = f"{begin:%m/%d/%Y},{begin.hour + 1:02d}:00"
        lines.append(f"{stamp},{row.ghi:.0f},{row.dni:.0f},{row.dhi:.0f},{row.temp_air},{row.wind_speed},1.5")
    return "\n".join(lines) + "\n", data


def epw(zone=0.0, comment="synthetic", shift=0.5):
    """EPW: hour 1 is the first of the day; the sky is that `shift` hours after the beginning, in UTC."""
    begins = typical_hours("UTC", (2011,))
    data = sky(begins + pd.Timedelta(hours=shift))
    lines = [f"LOCATION,Town,-,XXX,sample,000000,{LATITUDE},{LONGITUDE},{zone:.1f},{ALTITUDE:.1f}"]
    lines += ["DESIGN CONDITIONS,0", "TYPICAL/EXTREME PERIODS,0", "GROUND TEMPERATURES,0"]
    lines += ["HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0", "COMMENTS 1,sample", f"COMMENTS 2,{comment}"]
    lines += ["DATA PERIODS,1,1,Data,Sunday, 1/ 1,12/31"]
    for begin, row in zip(begins, data.itertuples(), strict=True):
        start = f"{begin.year},{begin.month},{begin.day},{begin.hour + 1},0,?9"
        light = f"9999,9999,300,{row.ghi:.0f},{row.dni:.0f},{row.dhi:.0f},999900,999900,999900,9999"
        rest = f"180,{row.wind_speed},5,5,9999,99999,9,999999999,15,0.1,0,88,0.2,0,0"
        lines.append(f"{start},{row.temp_air},5.0,60,101000,{light},{rest}")
    return "\n".join(lines) + "\n", data


OFFSET = 0.1761
"""Hours from the time stamps of PVGIS's typical year to its sky."""


def pvgis_typical():
    """CSV of PVGIS, typical year: UTC, and the sky is that `OFFSET` hours after the time stamp."""
    begins = typical_hours("UTC", (2012, 2007))
    data = sky(begins + pd.Timedelta(hours=OFFSET))
    lines = [
        f"Latitude (decimal degrees): {LATITUDE:.3f}",
        f"Longitude (decimal degrees): {LONGITUDE:.3f}",
        f"Elevation (m): {ALTITUDE}",
        f"Irradiance Time Offset (h): {OFFSET:.4f}",
        "month,year",
        *(f"{month},2012" for month in range(1, 13)),
        "time(UTC),T2m,RH,G(h),Gb(n),Gd(h),IR(h),WS10m,WD10m,SP",
    ]
    for begin, row in zip(begins, data.itertuples(), strict=True):
        light = f"{row.ghi},{row.dni},{row.dhi},300.0"
        lines.append(f"{begin:%Y%m%d:%H%M},{row.temp_air},60.0,{light},{row.wind_speed},180.0,101000.0")
    lines += ["", "T2m: 2-m air temperature (degree Celsius)", "", "PVGIS (c) European Union, 2001-2025"]
    return "\r\n".join(lines) + "\r\n", data


def pvgis_typical_json():
    """JSON of PVGIS, typical year, with the content of `pvgis_typical`."""
    text, data = pvgis_typical()
    rows = [line.split(",") for line in text.split("\r\n")[18 : 18 + HOURS]]
    names = ["time(UTC)", "T2m", "RH", "G(h)", "Gb(n)", "Gd(h)", "IR(h)", "WS10m", "WD10m", "SP"]
    place = {"latitude": LATITUDE, "longitude": LONGITUDE, "elevation": ALTITUDE}
    content = {
        "inputs": {"location": {**place, "irradiance_time_offset": OFFSET}},
        "outputs": {
            "months_selected": [{"month": month, "year": 2012} for month in range(1, 13)],
            "tmy_hourly": [dict(zip(names, [row[0], *map(float, row[1:])], strict=True)) for row in rows],
        },
        "meta": {"inputs": {}},
    }
    return json.dumps(content), data


def nsrdb():
    """CSV of NSRDB, half-hourly: the sky is that of the time stamps."""
    begins = typical_hours("UTC-01:00", (2019, 2020))
    stamps = begins.append(begins + pd.Timedelta(minutes=30))[np.arange(2 * HOURS).reshape(2, -1).T.ravel()]
    data = sky(stamps)
    lines = [
        "Source,Location ID,City,State,Country,Latitude,Longitude,Time Zone,Elevation,Local Time Zone",
        f"NSRDB,401182,-,-,-,{LATITUDE},{LONGITUDE},-1,{ALTITUDE:.0f},-1",
        "Year,Month,Day,Hour,Minute,Temperature,Cloud Type,DHI,DNI,Fill Flag,GHI,Wind Speed",
    ]
    for stamp, row in zip(stamps, data.itertuples(), strict=True):
        day = f"{stamp.year},{stamp.month},{stamp.day},{stamp.hour},{stamp.minute}"
        lines.append(f"{day},{row.temp_air},0,{row.dhi:.0f},{row.dni:.0f},0,{row.ghi:.0f},{row.wind_speed}")
    return "\n".join(lines) + "\n", data


def pvgis_hourly(first="2016-01-01", last="2016-12-31"):
    """CSV of PVGIS, hourly, of a horizontal plane: the sky is that of the time stamps, 10 minutes past."""
    stamps = pd.date_range(f"{first} 00:10", f"{last} 23:10", freq="h", tz="UTC")
    data = sky(stamps)
    solar = pvlib.solarposition.get_solarposition(stamps, LATITUDE, LONGITUDE, ALTITUDE, method="nrel_numpy")
    height = np.maximum(solar["apparent_elevation"].to_numpy(), 0.0)
    lines = [
        f"Latitude (decimal degrees):\t{LATITUDE:.3f}",
        f"Longitude (decimal degrees):\t{LONGITUDE:.3f}",
        f"Elevation (m):\t{ALTITUDE:.0f}",
        "Radiation database:\tPVGIS-SARAH2",
        "",
        "",
        "Slope: 0 deg. ",
        "Azimuth: 0 deg. ",
        "time,Gb(i),Gd(i),Gr(i),H_sun,T2m,WS10m,Int",
    ]
    for stamp, row, elevation in zip(stamps, data.itertuples(), height, strict=True):
        beam = row.dni * np.sin(np.radians(elevation))
        light = f"{beam:.2f},{row.dhi},0.0,{elevation:.2f}"
        lines.append(f"{stamp:%Y%m%d:%H%M},{light},{row.temp_air},{row.wind_speed},0.0")
    lines += ["", "Gb(i): Beam (direct) irradiance on the inclined plane (W/m2)"]
    return "\r\n".join(lines) + "\r\n", data


def pvgis_hourly_json():
    """JSON of PVGIS, hourly, with the content of `pvgis_hourly`."""
    text, data = pvgis_hourly()
    rows = [line.split(",") for line in text.split("\r\n")[9 : 9 + len(data)]]
    names = ["time", "Gb(i)", "Gd(i)", "Gr(i)", "H_sun", "T2m", "WS10m", "Int"]
    place = {"latitude": LATITUDE, "longitude": LONGITUDE, "elevation": ALTITUDE}
    fixed = {
        "slope": {"value": 0, "optimal": False},
        "azimuth": {"value": 0, "optimal": False},
        "type": "free",
    }
    hourly = [dict(zip(names, [row[0], *map(float, row[1:])], strict=True)) for row in rows]
    content = {
        "inputs": {"location": place, "mounting_system": {"fixed": fixed}},
        "outputs": {"hourly": hourly},
        "meta": {"inputs": {}},
    }
    return json.dumps(content), data
