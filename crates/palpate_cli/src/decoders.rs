//! From flags to a tactile decoder.

use anyhow::{Context as _, bail};
use palpate::io::{SceneFile, read_color, read_compact_weights, read_lookup_table, read_sensor};
use palpate::simulate::simulated_lookup_table;
use palpate::tactile::compact::CompactDecoder;
use palpate::tactile::{Border, LookupDecoder, NoContact, TactileDecoder, TactileSensor, ThresholdDecoder, Touch};
use std::path::{Path, PathBuf};

/// A way from a tactile image to a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub(crate) enum DecoderKind {
    /// Small network with the weights that come with palpate
    Compact,
    /// Colour table and fast Poisson, border relaxed (the published baseline); needs --lookup-table
    Lookup,
    /// The same with free borders
    LookupFree,
    /// Change of brightness: contact mask only, the height map is the relaxed gel
    Threshold,
    /// The published network; needs --weights and a build with the feature `nn`
    Fcrn,
    /// The gel's own calibration (`palpate calibrate gel`); needs --calibration
    Calibrated,
}

impl DecoderKind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Compact => "compact",
            Self::Lookup => "lookup",
            Self::LookupFree => "lookup-free",
            Self::Threshold => "threshold",
            Self::Fcrn => "fcrn",
            Self::Calibrated => "calibrated",
        }
    }

    /// Whether the height map is decoded, and not the relaxed gel.
    pub(crate) fn gives_heights(self) -> bool {
        self != Self::Threshold
    }
}

/// Files that decoders need.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct DecoderFiles {
    /// Colour table of the decoder 'lookup': a folder with grad_mag.npy and grad_dir.npy, or `simulated` for one calibrated on
    /// simulated balls
    #[arg(long, value_name = "DIR")]
    pub(crate) lookup_table: Option<PathBuf>,
    /// Weights of a network, instead of those that come with palpate
    #[arg(long, value_name = "FILE")]
    pub(crate) weights: Option<PathBuf>,
    /// Weights of a contact network, for the decoder 'fcrn'; without them contact is read off the heights
    #[arg(long, value_name = "FILE", requires = "weights")]
    pub(crate) mask_weights: Option<PathBuf>,
    /// Calibration of this very sensor, for the decoder 'calibrated': the sensor.toml of `palpate calibrate gel`
    #[arg(long, value_name = "TOML")]
    pub(crate) calibration: Option<PathBuf>,
}

impl DecoderFiles {
    /// A warning for each file that this decoder does not take.
    pub(crate) fn idle(&self, kind: DecoderKind) -> Vec<String> {
        use DecoderKind::{Calibrated, Compact, Fcrn, Lookup, LookupFree};
        let flags: [(&str, &Option<PathBuf>, &[DecoderKind]); 4] = [
            ("--lookup-table", &self.lookup_table, &[Lookup, LookupFree]),
            ("--weights", &self.weights, &[Compact, Fcrn]),
            ("--mask-weights", &self.mask_weights, &[Fcrn]),
            ("--calibration", &self.calibration, &[Calibrated]),
        ];
        let idle = flags.into_iter().filter(|(_, file, takers)| file.is_some() && !takers.contains(&kind));
        idle.map(|(flag, ..)| format!("{flag} is not used: the decoder is '{}'", kind.name())).collect()
    }
}

/// Where the height maps of a scene's touches come from.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct TouchDecoder {
    /// Where height maps come from
    #[arg(long, value_enum, default_value_t = Source::Auto)]
    decoder: Source,
    #[command(flatten)]
    files: DecoderFiles,
}

#[derive(Debug, Clone, Copy, PartialEq, clap::ValueEnum)]
enum Source {
    /// Recorded maps; where a touch has only an image, the gel's calibration if there is one (--calibration, or sensor.toml in
    /// the scene's folder), else the compact network
    Auto,
    /// Recorded maps; images are ignored
    Recorded,
    /// Images, by the compact network, also where maps are recorded
    Compact,
    /// Images, by colour table and fast Poisson; needs --lookup-table
    Lookup,
    /// Images, by the published network; needs --weights and a build with the feature `nn`
    Fcrn,
    /// Images, by the gel's calibration: --calibration, or sensor.toml in the scene's folder
    Calibrated,
}

impl Source {
    /// The decoder of images, if any.
    fn kind(self) -> Option<DecoderKind> {
        match self {
            Self::Recorded => None,
            Self::Auto | Self::Compact => Some(DecoderKind::Compact),
            Self::Lookup => Some(DecoderKind::Lookup),
            Self::Fcrn => Some(DecoderKind::Fcrn),
            Self::Calibrated => Some(DecoderKind::Calibrated),
        }
    }
}

impl TouchDecoder {
    /// Whether images were asked for, also where maps are recorded.
    fn wants_images(&self) -> bool {
        !matches!(self.decoder, Source::Auto | Source::Recorded)
    }

    /// Recorded maps beside an image go where the images were asked for.
    pub(crate) fn drop_unwanted_maps(&self, touch: &mut Touch) {
        if self.wants_images() && touch.image.is_some() {
            touch.contact = None;
        }
    }

    /// What was asked for and is not there, if the scene has no images to decode.
    ///
    /// * `more` – whether touches may be added later, and decoded
    fn unused(&self, touches: &[Touch], more: bool) -> Option<String> {
        let without = touches.iter().filter(|t| t.image.is_none()).count();
        if self.wants_images() && without > 0 {
            let name = self.decoder.kind().map_or("", DecoderKind::name);
            let all = touches.len();
            return Some(format!(
                "--decoder {name}: {without} of {all} touches have no image; their recorded height maps are used"
            ));
        }
        let files = &self.files;
        let given = files.calibration.is_some() || files.weights.is_some() || files.lookup_table.is_some();
        let decoded = more || touches.iter().any(|t| t.contact.is_none());
        (given && !decoded && !touches.is_empty() && !self.wants_images()).then(|| {
            "every touch has a recorded height map, so none is decoded; --decoder says by what the images are to be read"
                .to_owned()
        })
    }

    /// The decoder of the scene's tactile images, if any is to be decoded. Recorded maps beside images are dropped where the images
    /// were asked for; what is asked for in vain is added to the scene's warnings.
    ///
    /// * `more` – whether touches may be added later
    pub(crate) fn of_scene(
        &self,
        file: &mut SceneFile,
        folder: &Path,
        more: bool,
    ) -> anyhow::Result<Option<Box<dyn TactileDecoder>>> {
        let more = more && file.tactile_background.is_some();
        file.warnings.extend(self.unused(&file.scene.touches, more));
        let Some(kind) = self.decoder.kind() else { return Ok(None) };
        file.scene.touches.iter_mut().for_each(|touch| self.drop_unwanted_maps(touch));
        let with_image = |touch: &Touch| touch.contact.is_none() && touch.image.is_some();
        let needed = file.scene.touches.iter().any(with_image) || more;
        let Some(sensor) = file.scene.sensor.as_ref().filter(|_| needed) else { return Ok(None) };
        let background = file.tactile_background.clone().with_context(|| {
            format!(
                "scene '{}': [sensor] background (the no-contact image) is needed to decode images",
                file.scene.name
            )
        })?;
        let no_contact = NoContact::new(background, sensor).context("[sensor] background")?;
        let mut files = self.files.clone();
        let beside = if folder.is_file() { folder.with_file_name("sensor.toml") } else { folder.join("sensor.toml") };
        if files.calibration.is_none() && beside.is_file() {
            files.calibration = Some(beside);
        }
        let calibrated = self.decoder == Source::Auto && files.calibration.is_some();
        let kind = if calibrated { DecoderKind::Calibrated } else { kind };
        file.warnings.extend(self.files.idle(kind));
        make(kind, no_contact, sensor, &files).map(Some)
    }
}

/// Makes a decoder for a sensor whose no-contact image this is.
pub(crate) fn make(
    kind: DecoderKind,
    no_contact: NoContact,
    sensor: &TactileSensor,
    files: &DecoderFiles,
) -> anyhow::Result<Box<dyn TactileDecoder>> {
    let lookup = |border| -> anyhow::Result<Box<dyn TactileDecoder>> {
        let table = match &files.lookup_table {
            Some(folder) if folder.as_os_str() == "simulated" => simulated_lookup_table(sensor)?,
            Some(folder) => read_lookup_table(folder)?,
            None => bail!(
                "the decoder '{}' needs --lookup-table: a folder with grad_mag.npy and grad_dir.npy (the table of the \
                 YCB-Sight release cannot be shipped, its licence is CC BY-SA), or `simulated`",
                kind.name()
            ),
        };
        Ok(Box::new(LookupDecoder::new(table, no_contact.clone(), border)))
    };
    match kind {
        DecoderKind::Lookup => lookup(Border::Relaxed),
        DecoderKind::LookupFree => lookup(Border::Free),
        DecoderKind::Threshold => Ok(Box::new(ThresholdDecoder::new(no_contact))),
        DecoderKind::Compact => Ok(Box::new(match &files.weights {
            None => CompactDecoder::shipped(no_contact),
            Some(path) => CompactDecoder::new(&read_compact_weights(path)?, no_contact)
                .with_context(|| format!("weights {}", path.display()))?,
        })),
        DecoderKind::Fcrn => fcrn(no_contact, files),
        DecoderKind::Calibrated => calibrated(&no_contact, sensor, files),
    }
}

fn calibrated(
    no_contact: &NoContact,
    sensor: &TactileSensor,
    files: &DecoderFiles,
) -> anyhow::Result<Box<dyn TactileDecoder>> {
    let Some(path) = &files.calibration else {
        bail!("the decoder 'calibrated' needs --calibration: the sensor.toml of `palpate calibrate gel`");
    };
    let file = read_sensor(path)?;
    let ((width, height), (found_width, found_height)) = (sensor.pad_size(), file.sensor.pad_size());
    // A pixel of another size would scale every height without a word.
    let same = |a: f64, b: f64| (a / b - 1.0).abs() < 0.005;
    if !same(width, found_width) || !same(height, found_height) {
        bail!(
            "{}: the calibrated pad is {:.2}×{:.2} mm, the sensor's is {:.2}×{:.2} mm (width × height): is it of this sensor? A scene of \
             this sensor has model = \"custom\", width = {}, height = {}, pixel_pitch = {:?}",
            path.display(),
            1e3 * found_width,
            1e3 * found_height,
            1e3 * width,
            1e3 * height,
            file.sensor.width,
            file.sensor.height,
            file.sensor.pixel_pitch
        );
    }
    let decoder = file.decoder(Some(no_contact.image())).with_context(|| path.display().to_string())?;
    Ok(Box::new(decoder))
}

#[cfg(feature = "nn")]
fn fcrn(no_contact: NoContact, files: &DecoderFiles) -> anyhow::Result<Box<dyn TactileDecoder>> {
    let Some(height) = &files.weights else {
        bail!("the decoder 'fcrn' needs --weights FILE of a height network (`palpate train height-map`)");
    };
    let decoder = palpate_nn::FcrnDecoder::open(height, files.mask_weights.as_deref(), no_contact)
        .with_context(|| format!("weights {}", height.display()))?;
    Ok(Box::new(decoder))
}

#[cfg(not(feature = "nn"))]
fn fcrn(_no_contact: NoContact, _files: &DecoderFiles) -> anyhow::Result<Box<dyn TactileDecoder>> {
    bail!("this palpate was built without networks; for the decoder 'fcrn' build it with --features palpate_cli/nn")
}

/// Reads the no-contact image of a sensor.
pub(crate) fn read_no_contact(path: &Path, sensor: &TactileSensor) -> anyhow::Result<NoContact> {
    NoContact::new(read_color(path)?, sensor).with_context(|| format!("background {}", path.display()))
}
