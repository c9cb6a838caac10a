//! Choice of the format in which a webcam delivers pictures.
//!
//! | case | consequence |
//! |---|---|
//! | the optics are known for one size | only this size, else refused with the sizes |
//! | any size will do | the nearest size that the camera has |
//! | one camera | `YUYV` before `MJPG`: its colours suffer no compression |
//! | several cameras | `MJPG` before `YUYV`: they may share a bus |
//! | no room on the bus (`ENOSPC`) | the next choice: the other encoding, then a smaller size |
//! | the driver gives another format | taken if any size will do, else the next choice |
//!
//! - in: the offers of a device, and what is wanted
//! - out: the format of a stream that runs; or the reason why there is none

use super::device::{Encoding, Format, Offer, Size, Sizes, VideoDevice, name_of};
use rustix::io::Errno;
use std::io;

/// Least width of a picture that is chosen for its small size (px). Nine tiles need some pixels.
const LEAST_WIDTH: u32 = 320;

/// Format that is wanted of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wish {
    /// Size of the pictures.
    pub size: Size,
    /// Whether no other size will do, because the optics are known for this one.
    pub exact: bool,
    /// Whether several webcams are in use, which may share a bus.
    pub shared: bool,
    /// The only encoding to be used; `None` for any.
    pub only: Option<Encoding>,
}

/// Reason why a device gives no pictures.
#[derive(Debug)]
pub enum Trouble {
    /// Error of the operating system.
    System(io::Error),
    /// The device has nothing that fits, with the reason.
    Refused(String),
}

impl From<io::Error> for Trouble {
    fn from(why: io::Error) -> Self {
        Self::System(why)
    }
}

/// Starts a device in the first format of `choices` that it gives; returns the format.
///
/// # Errors
/// [`Trouble`] if no choice works.
pub fn negotiate(device: &mut dyn VideoDevice, wish: &Wish) -> Result<Format, Trouble> {
    let choices = choices(&device.offers()?, wish).map_err(Trouble::Refused)?;
    let (mut no_room, mut given) = (Vec::new(), None);
    for (encoding, size) in choices {
        let asked = format!("{}x{} {encoding}", size.0, size.1);
        let format = device.set_format(encoding.code(), size)?;
        let fits = if wish.exact { format.size == size } else { true };
        // A wish for one encoding holds for the format that is given, too.
        let known = Encoding::of(format.code).filter(|e| wish.only.is_none_or(|only| only == *e));
        if !fits || known.is_none() {
            let (w, h) = format.size;
            given = Some(format!("asked for {asked}, it gives {w}x{h} {}", name_of(format.code)));
            continue;
        }
        match device.start() {
            Ok(()) => return Ok(format),
            Err(why) if why.raw_os_error() == Some(Errno::NOSPC.raw_os_error()) => {
                no_room.push(asked);
            }
            Err(why) => return Err(why.into()),
        }
    }
    Err(Trouble::Refused(if no_room.is_empty() {
        given.unwrap_or_else(|| "it has no format that fits".to_owned())
    } else {
        format!(
            "the USB bus has no room for {}: connect it to another USB controller than the other \
             cameras, or choose a smaller size",
            no_room.join(", ")
        )
    }))
}

/// Returns the encodings and sizes to be tried, the best first.
///
/// # Errors
/// The reason why the device has nothing that fits, with its offers.
fn choices(offers: &[Offer], wish: &Wish) -> Result<Vec<(Encoding, Size)>, String> {
    let order = if wish.shared {
        [Encoding::Mjpeg, Encoding::Yuyv]
    } else {
        [Encoding::Yuyv, Encoding::Mjpeg]
    };
    let usable: Vec<(Encoding, &Offer)> = order
        .into_iter()
        .filter(|encoding| wish.only.is_none_or(|only| only == *encoding))
        .filter_map(|e| Some((e, offers.iter().find(|offer| offer.code == e.code())?)))
        .collect();
    if usable.is_empty() {
        let read = wish.only.map_or_else(|| "YUYV and MJPG".to_owned(), |only| only.to_string());
        return Err(format!("it has no {read}; it has {}", list(offers)));
    }
    // A driver that lists no sizes is asked for the wanted one.
    let nearest =
        |offer: &Offer| offer.sizes.iter().map(|s| s.nearest(wish.size)).collect::<Vec<_>>();
    let mut all: Vec<(Encoding, Size)> = usable
        .iter()
        .flat_map(|(e, offer)| {
            let sizes = nearest(offer);
            let sizes = if sizes.is_empty() { vec![wish.size] } else { sizes };
            sizes.into_iter().map(|size| (*e, size))
        })
        .filter(|(_, size)| !wish.exact || *size == wish.size)
        .collect();
    if all.is_empty() {
        let (width, height) = wish.size;
        return Err(format!(
            "it has no {width}x{height} px, for which the optics are given; it has {}",
            list(offers)
        ));
    }
    let pixels = |size: Size| u64::from(size.0) * u64::from(size.1);
    let distance = |size: Size| pixels(size).abs_diff(pixels(wish.size));
    // The sort keeps the order of the encodings. After the best size only smaller ones follow:
    // they need less of the bus.
    all.sort_by_key(|(_, size)| distance(*size));
    let best = all[0].1;
    all.retain(|(_, size)| {
        *size == best || (pixels(*size) < pixels(best) && size.0 >= LEAST_WIDTH)
    });
    Ok(all)
}

/// Returns the offers as a text.
fn list(offers: &[Offer]) -> String {
    let sizes =
        |sizes: &[Sizes]| sizes.iter().map(|size| format!(" {size}")).collect::<Vec<_>>().join(",");
    let all: Vec<String> = offers
        .iter()
        .map(|offer| format!("{}{}", name_of(offer.code), sizes(&offer.sizes)))
        .collect();
    if all.is_empty() { "no format".to_owned() } else { all.join("; ") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::webcam::testing::{Fake, offer};

    const VGA: Size = (640, 480);
    const ANY: Wish = Wish { size: VGA, exact: false, shared: false, only: None };
    const EXACT: Wish = Wish { exact: true, ..ANY };

    /// Negotiates with a device; returns format and size, or the reason.
    fn agreed(fake: &Fake, wish: &Wish) -> Result<(String, Size), String> {
        match negotiate(&mut fake.clone(), wish) {
            Ok(format) => Ok((name_of(format.code), format.size)),
            Err(Trouble::Refused(why)) => Err(why),
            Err(Trouble::System(why)) => Err(format!("system: {why}")),
        }
    }

    /// Returns a device with both encodings in two sizes.
    fn both() -> Fake {
        Fake::with(vec![
            offer(*b"MJPG", &[(1280, 720), VGA]),
            offer(*b"YUYV", &[VGA, (320, 240)]),
            offer(*b"H264", &[VGA]),
        ])
    }

    #[test]
    fn uncompressed_pictures_are_preferred_for_one_camera() {
        assert_eq!(agreed(&both(), &ANY), Ok(("YUYV".into(), VGA)));
        assert_eq!(agreed(&both(), &Wish { shared: true, ..ANY }), Ok(("MJPG".into(), VGA)));
        let only = Wish { only: Some(Encoding::Mjpeg), ..ANY };
        assert_eq!(agreed(&both(), &only), Ok(("MJPG".into(), VGA)));
    }

    #[test]
    fn only_offered_encoding_is_taken() {
        for code in [*b"YUYV", *b"MJPG"] {
            let fake = Fake::with(vec![offer(code, &[VGA])]);
            assert_eq!(agreed(&fake, &EXACT), Ok((name_of(code), VGA)));
        }
        let fake = Fake::with(vec![offer(*b"H264", &[VGA]), offer(*b"GREY", &[])]);
        let why = agreed(&fake, &ANY).unwrap_err();
        assert_eq!(why, "it has no YUYV and MJPG; it has H264 640x480; GREY");
        let only = Wish { only: Some(Encoding::Yuyv), ..ANY };
        let why = agreed(&Fake::with(vec![offer(*b"MJPG", &[VGA])]), &only).unwrap_err();
        assert!(why.starts_with("it has no YUYV; it has MJPG"), "{why}");
    }

    #[test]
    fn size_without_optics_is_refused_with_offers() {
        let wish = Wish { size: (800, 600), ..EXACT };

        let why = agreed(&both(), &wish).unwrap_err();

        assert!(why.starts_with("it has no 800x600 px, for which the optics"), "{why}");
        assert!(why.contains("MJPG 1280x720, 640x480; YUYV 640x480, 320x240"), "{why}");
        assert_eq!(agreed(&both(), &Wish { exact: false, ..wish }).unwrap().1, VGA);
    }

    /// A driver answers a wish with what it has, and lists no sizes.
    #[test]
    fn other_size_than_asked_is_refused_or_taken() {
        let fake = Fake { gives: Some((1280, 720)), ..Fake::with(vec![offer(*b"MJPG", &[])]) };

        let why = agreed(&fake, &EXACT).unwrap_err();
        assert_eq!(why, "asked for 640x480 MJPG, it gives 1280x720 MJPG");
        assert_eq!(agreed(&fake, &ANY), Ok(("MJPG".into(), (1280, 720))));
    }

    #[test]
    fn full_bus_leads_to_smaller_format() {
        let room = |bytes| Fake { room: bytes, ..both() };

        // A YUYV picture has two bytes a pixel; the fake counts a fifth of a byte for MJPG.
        assert_eq!(agreed(&room(620_000), &ANY), Ok(("YUYV".into(), VGA)));
        assert_eq!(agreed(&room(100_000), &ANY), Ok(("MJPG".into(), VGA)));
        let only = Wish { only: Some(Encoding::Yuyv), ..ANY };
        assert_eq!(agreed(&room(160_000), &only), Ok(("YUYV".into(), (320, 240))));
        let why = agreed(&room(1_000), &EXACT).unwrap_err();
        assert!(why.starts_with("the USB bus has no room for 640x480 YUYV, 640x480 MJPG"), "{why}");
        assert!(why.contains("another USB controller"), "{why}");
    }

    #[test]
    fn busy_device_is_an_error_of_the_system() {
        let fake = Fake { busy: true, ..both() };

        assert!(agreed(&fake, &ANY).unwrap_err().starts_with("system: "));
    }

    #[test]
    fn stepwise_sizes_are_met_at_steps() {
        let sizes = Sizes::Steps { least: (48, 32), most: (1280, 960), step: (16, 8) };
        assert_eq!(sizes.nearest(VGA), VGA);
        assert_eq!(sizes.nearest((650, 483)), VGA);
        assert_eq!(sizes.nearest((9999, 1)), (1280, 32));
        let offers = vec![Offer { code: *b"YUYV", sizes: vec![sizes] }];

        assert_eq!(agreed(&Fake::with(offers), &EXACT), Ok(("YUYV".into(), VGA)));
    }
}
